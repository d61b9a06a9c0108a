"""A track as a recording of rerun, which its viewer shows on a time line."""

import contextlib

import numpy as np

from ...errors import needs

#: The arrow of a velocity is the way in so many seconds.
ARROW_S = 0.1

_OFF, _ON, _ROI, _SURE, _DOUBTFUL = (92, 140, 240), (255, 255, 255), (220, 60, 60), (60, 200, 120), (240, 150, 40)

#: Columns of the track that are drawn over time.
SERIES = ("vx_px_per_s", "vy_px_per_s", "confidence")


@contextlib.contextmanager
def rerun(path, config):
    """What takes the batches, and writes them to ``path`` as they come."""
    with needs("rerun", "rerun", f"export {path.name}"):
        import rerun as rr
    stream = rr.RecordingStream("cmfpga")
    path.touch()  # what cannot be written is told by the system
    stream.save(path)
    try:
        yield _Viewer(rr, stream, (config.roi_width, config.roi_height))
    finally:
        stream.disconnect()  # which writes what is left


class _Viewer:
    def __init__(self, rr, stream, size):
        self._rr, self._stream, self._size = rr, stream, np.array(size, np.float64)

    def add(self, batch):
        """Write a batch, at the middle of its time range; nothing without events."""
        values, rr, log = batch.values, self._rr, self._stream.log
        if values["t_ref_us"] is None:
            return
        ns = int(2 * values["t_ref_us"]) * 500
        self._stream.set_time("recording", duration=np.timedelta64(ns, "ns"))
        corner = np.array([values["roi_x"], values["roi_y"]], np.float64)
        colours = np.array([_OFF, _ON], np.uint8)[np.asarray(batch.events.p, np.int64)]
        log("sensor/events", rr.Points2D(np.stack([batch.seen.x, batch.seen.y], axis=1), colors=colours))
        box = {"mins": [corner - 0.5], "sizes": [self._size]}
        log("sensor/roi", rr.Boxes2D(**box, colors=[_ROI]))
        v = [values["vx_px_per_s"], values["vy_px_per_s"]]
        there = [] if None in v else [np.array(v) * ARROW_S]
        middle = [corner + (self._size - 1) / 2] * len(there)
        colour = [_SURE if values["trusted"] else _DOUBTFUL] * len(there)
        log("sensor/velocity", rr.Arrows2D(vectors=there, origins=middle, colors=colour))
        for name in SERIES:
            if values[name] is not None:
                log(f"track/{name}", rr.Scalars(values[name]))
