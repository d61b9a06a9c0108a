"""Bit-exact integer model: one file per block, named like the block's RTL.

All values are raw integers of the formats in :class:`cmfpga.config.Config`, in int64 tensors.
"""
