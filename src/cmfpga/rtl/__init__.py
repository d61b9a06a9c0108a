"""The accelerator's blocks, one file per box of the block diagram (docs/architecture.md)."""
