"""Blocks of the AXI top, each against its model."""
