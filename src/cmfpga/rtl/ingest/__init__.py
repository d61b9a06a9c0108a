"""Blocks that take a batch in."""
