"""Events in: recordings, synthetic scenes, and batches cut from them."""

from . import aedat, bags, cameras, hdf5, numpy_files, raw, text
from .arrays import Events, EventSource
from .batches import WAITING, Batch, BatchCutter
from .columns import MemoryRecording, as_events
from .hdf5 import Hdf5Writer, write_hdf5
from .live import Feed, LiveSource, is_live, open_source
from .motion import Motion
from .recording import Format, Recording, formats, forms, open_recording, register_format
from .synthetic import Scene, Synthetic, generate

# Text is registered first: it matches loosely, so it must be asked last.
for _format in (
    *text.FORMATS, *aedat.FORMATS, *cameras.FORMATS, raw.FORMAT, *hdf5.FORMATS, *numpy_files.FORMATS, aedat.NMNIST,
    *bags.FORMATS,
):  # fmt: skip
    register_format(_format)

__all__ = [
    "WAITING", "Batch", "BatchCutter", "EventSource", "Events", "Feed", "Format", "Hdf5Writer", "LiveSource",
    "MemoryRecording", "Motion", "Recording", "Scene", "Synthetic", "as_events", "formats", "forms", "generate",
    "is_live", "open_recording", "open_source", "register_format", "write_hdf5",
]  # fmt: skip
