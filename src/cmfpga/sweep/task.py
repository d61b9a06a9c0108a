"""One task of a sweep: one object of one recording, tracked with one configuration. This runs on the workers."""

import contextlib
import functools
import hashlib
import importlib.resources
import json
import math
import traceback
from dataclasses import asdict, dataclass

from .. import __version__
from ..config import Config
from ..errors import ConfigError, UserError
from ..imaging.iwe import gain, scaled_roi_events
from ..truth import Truth

#: Contrasts and gains are kept with so many digits, so that an order of summation does not show.
DIGITS = 9

#: Columns of a batch behind those of ``track.csv``: how many times the contrast at v = 0 that at v is, dithered; the
#: true motion, and the distance from it, px per half batch.
MORE_COLUMNS = ("gain", "true_vx", "true_vy", "error_px")


@functools.cache
def version():
    """Version of cmfpga, and a digest of its sources: what is kept from another one is not taken for a result."""
    digest = hashlib.sha256()
    root = importlib.resources.files("cmfpga")
    for file in sorted((file for file in _files(root) if file.name.endswith((".py", ".cpp"))), key=str):
        digest.update(file.read_bytes())
    return f"{__version__}+{digest.hexdigest()[:12]}"


def _files(folder):
    for entry in folder.iterdir():
        yield from _files(entry) if entry.is_dir() else (entry,)


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a worker needs.

    Parameters
    ----------
    path : str
        The recording, as the workers find it.
    digest : str
        SHA-256 of its content.
    config : Config
    roi : (int, int)
        Left column and top row of the first batch's ROI, px.
    engine : str
    size : dict
        ``{"events": N}``, ``{"duration_us": D}`` or ``{"roi_events": M}``; empty: as long as suits the motion.
    start_event : int
    batches : int or None
    sensor, time_unit
        As of :func:`~cmfpga.events.open_recording`.
    truth : Truth or None
    version : str
        :func:`version` of who made the task.
    """

    path: str
    digest: str
    config: Config
    roi: tuple[int, int]
    engine: str
    size: dict
    start_event: int
    batches: int | None
    sensor: tuple[int, int] | None
    time_unit: str | None
    truth: Truth | None
    version: str

    @functools.cached_property
    def key(self):
        """Hexadecimal SHA-256 of all that the result depends on; where the recording lies is not among it."""
        fields = {**asdict(self), "config": self.config.to_dict()}
        del fields["path"]
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def run_task(task):
    """Track; never raises what a task can be blamed for.

    Returns
    -------
    dict
        JSON-ready. ``status`` is ``"ok"``, with ``batches`` (a list of dictionaries, see :func:`_batch`),
        ``events_left_over`` and ``note``; or ``"failed"``, with ``reason`` and, for a defect, ``traceback``.
    """
    return guarded(_track, task, task.version)


def guarded(function, argument, needed):
    """``function(argument)`` in a process whose :func:`version` is the one ``needed``; failures as a dictionary."""
    try:
        if version() != needed:
            raise ConfigError(f"a worker has cmfpga {version()}; {needed} is needed, as where the sweep was started")
        return {"status": "ok", **function(argument)}
    except UserError as error:
        return {"status": "failed", "reason": " ".join(str(error).splitlines())}
    except Exception as error:
        reason = " ".join([f"{type(error).__name__}:", *str(error).splitlines()[:1]])
        return {"status": "failed", "reason": reason, "traceback": traceback.format_exc()}


def _track(task):
    # Here and not above: where a sweep is only looked up, none of this is needed.
    from ..engines import open_engine
    from ..events import open_recording
    from ..tracking.fit import batch_cutter
    from ..tracking.loop import track

    motion = task.truth.motion if task.truth else None
    with contextlib.ExitStack() as stack:
        recording = stack.enter_context(open_recording(task.path, sensor=task.sensor, time_unit=task.time_unit))
        cutter = batch_cutter(recording, task.config, start_event=task.start_event, **task.size)
        engine = stack.enter_context(contextlib.closing(open_engine(task.engine, task.config, option="--engine")))
        tracked = track(engine, cutter, roi=task.roi, batches=task.batches)
        batches = [_batch(batch, motion, task.config) for batch in tracked]
        if not batches:
            raise cutter.too_few()
        return {"batches": batches, "events_left_over": cutter.leftover, "note": engine.note}


def _batch(batch, motion, config):
    """The columns of track.csv as numbers, and :data:`MORE_COLUMNS`."""
    row = {**batch.values, **dict.fromkeys(MORE_COLUMNS)}
    if batch.v_px_per_s:  # a degenerate batch measures nothing
        events = scaled_roi_events(config, batch.seen, batch.result.roi, **batch.which | {"thinned": True})
        row["gain"] = gain(config, *events, batch.result.v, batch.result.roi)
    row |= {name: row[name] and float(f"{row[name]:.{DIGITS}g}") for name in ("contrast", "gain")}
    if motion is not None and len(batch.events):
        first = int(batch.events.t[0])
        true = motion.per_half_batch(first, first + batch.result.span).tolist()
        row["true_vx"], row["true_vy"] = true
        if batch.v_px_per_s:
            row["error_px"] = math.dist(batch.result.v[:2], true)
    return row


def estimate_resources(argument):
    """Resources of a hardware, ``argument`` being its configuration and the version; as :func:`run_task`."""
    return guarded(_estimate, *argument)


def _estimate(config):
    from ..fpga import resources
    from ..rtl.top import VerilogCore
    from ..verilog.emit import emit_verilog

    found = resources.estimate(emit_verilog(VerilogCore(config)))
    return {"total": found["total"], "yosys": found["yosys"], "estimate": found["estimate"]}
