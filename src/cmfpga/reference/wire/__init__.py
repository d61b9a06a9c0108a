"""Models of what stands between the AXI4-Stream input and the core: words to events, events to batches."""

from .batch_end import BatchEnds, split_batches
from .decoders import Beat, Token, decode, sensor_gate, to_beats

__all__ = ["BatchEnds", "Beat", "Token", "decode", "sensor_gate", "split_batches", "to_beats"]
