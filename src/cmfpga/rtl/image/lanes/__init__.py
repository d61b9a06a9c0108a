"""Blocks that sum the votes of several events a cycle (docs/lanes.md)."""
