"""Bit-exact integer model: functions are named like the blocks of the RTL.

All values are raw integers of the formats in :class:`cmfpga.config.Config`, in int64 tensors.
"""
