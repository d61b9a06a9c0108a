"""Blocks that find out how sure v is, after a batch's last iteration (docs/confidence.md)."""
