"""Blocks from an event to the sums of the image of warped events and its derivatives."""
