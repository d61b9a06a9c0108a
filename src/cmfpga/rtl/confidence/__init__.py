"""Blocks that find out how sure a batch's v is (docs/rounds.md)."""
