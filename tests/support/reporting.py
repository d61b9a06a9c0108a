"""Tracks for the reports."""

from cmfpga.engines import make_engine
from cmfpga.events import BatchCutter
from cmfpga.tracking.kept import Kept
from cmfpga.tracking.loop import track


def keep(config, recording, *, roi, size, batches=None, motion=None, start_event=0, engine="model"):
    """The :class:`Kept` of a track by the model."""
    kept = Kept(config, engine, recording.name, motion)
    cutter = BatchCutter(recording, start_event=start_event, events=size, max_events=config.max_batch_events)
    running = make_engine(engine, config)
    for batch in track(running, cutter, roi=roi, batches=batches):
        kept.add(batch)
    running.close()
    return kept
