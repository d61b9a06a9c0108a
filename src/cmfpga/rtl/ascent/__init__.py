"""Blocks that move v, and the ROI after it."""
