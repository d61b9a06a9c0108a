"""One task of a sweep, where the tasks run, and what is kept of them.

A task is one object of one recording, tracked with one configuration. Tasks run on a local Dask cluster, or on a Dask
scheduler that is there already. What was computed is kept, one file each, so that a sweep goes on where it stopped.
"""

import contextlib
import functools
import hashlib
import json
import logging
import math
import os
import signal
import sys
import traceback
import uuid
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from .. import __version__
from ..config import Config
from ..errors import ConfigError, UserError, naming
from ..forms import check
from ..imaging.iwe import gain, scaled_roi_events
from ..truth import Truth
from ..verilog.compiler import package_digest

#: A larger file is not read: some 40,000 batches, which become twenty times as many bytes in memory.
MOST_BYTES = 1 << 24


class Store:
    """Outcomes by their key, in a folder that is made when it is first written to.

    A file is complete or absent: it is written under another name and then renamed. Only ``"ok"`` is kept; what failed
    is tried again the next time.
    """

    def __init__(self, folder):
        self.folder = Path(folder)

    def get(self, key, form):
        """The outcome kept under ``key``; None where it has another form (:mod:`cmfpga.forms`): a changed file."""
        path = self.folder / f"{key}.json"
        try:
            if not path.is_file() or path.stat().st_size > MOST_BYTES:
                return None
            outcome = json.loads(path.read_text(encoding="utf-8"))
            check(outcome, form, key)
            return outcome if outcome["status"] == "ok" else None
        except (OSError, ValueError, RecursionError):  # damaged, or changed
            return None

    def put(self, key, outcome):
        """Keep ``outcome`` if it is ``"ok"``; returns it as :meth:`get` would."""
        text = json.dumps(outcome)
        if outcome["status"] == "ok":
            self.folder.mkdir(parents=True, exist_ok=True)
            write_atomically(self.folder / f"{key}.json", text.encode())
        return json.loads(text)


def write_atomically(path, content):
    """Write bytes so that whoever reads ``path`` finds what was there before, or all of it."""
    scratch = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with naming(path), scratch.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(scratch, path)
    except BaseException:
        scratch.unlink(missing_ok=True)  # an interrupt may come when it has its name already
        raise


#: Contrasts and gains are kept with so many digits, so that an order of summation does not show.
DIGITS = 9

#: Columns of a batch behind those of ``track.csv``: how many times the contrast at v = 0 that at v is, dithered; the
#: true motion, and the distance from it, px per half batch.
MORE_COLUMNS = ("gain", "true_vx", "true_vy", "error_px")


def version():
    """Version of cmfpga, and a digest of its sources: what is kept from another one is not taken for a result."""
    return f"{__version__}+{package_digest()[:12]}"


@dataclass(frozen=True, kw_only=True)
class Run:
    """What all tasks of a sweep have in common."""

    engine: str = "rtl"
    size: dict = field(default_factory=dict)  # {"events": N}, {"duration_us": D} or {"roi_events": M}; empty: as suits
    start_event: int = 0
    batches: int | None = None
    sensor: tuple[int, int] | None = None  # this and the next as of :func:`~cmfpga.events.open_recording`
    time_unit: str | None = None


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a worker needs."""

    path: str  # of the recording, as the workers find it
    digest: str  # SHA-256 of its content
    config: Config
    roi: tuple[int, int]  # left column and top row of the first batch's, px
    run: Run
    truth: Truth | None
    version: str  # :func:`version` of who made the task

    @functools.cached_property
    def key(self):
        """Hexadecimal SHA-256 of all that the result depends on; where the recording lies is not among it."""
        fields = {**asdict(self), "config": self.config.to_dict()}
        del fields["path"]
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def run_task(task):
    """Track; never raises what a task can be blamed for. Returns a dictionary, JSON-ready.

    ``status`` is ``"ok"``, with ``batches`` (a list of dictionaries, see :func:`_batch`), ``events_left_over`` and
    ``note``; or ``"failed"``, with ``reason`` and, for a defect, ``traceback``.
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

    motion, run = task.truth.motion if task.truth else None, task.run
    with contextlib.ExitStack() as stack:
        recording = stack.enter_context(open_recording(task.path, sensor=run.sensor, time_unit=run.time_unit))
        cutter = batch_cutter(recording, task.config, start_event=run.start_event, **run.size)
        engine = stack.enter_context(contextlib.closing(open_engine(run.engine, task.config, option="--engine")))
        tracked = track(engine, cutter, roi=task.roi, batches=run.batches)
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
            row["error_px"] = math.dist(batch.v[:2], true)
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


#: How long a scheduler may take to answer, s.
TIMEOUT = 10


def processors():
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Dask:
    """Runs tasks on the workers of a Dask scheduler, in any order."""

    client: Any
    where: str

    def run(self, function, jobs):
        """Yields ``(key, outcome)`` of ``function(argument)`` for each ``(key, argument)`` of ``jobs``.

        A worker that dies loses nothing: what it had is run by another one.
        """
        from distributed import CancelledError, KilledWorker, as_completed

        submit = functools.partial(self.client.submit, function, pure=False)
        futures = {submit(argument, key=f"cmfpga-{key}"): key for key, argument in jobs.items()}
        for future, outcome in as_completed(futures, with_results=True, raise_errors=False):
            # Not by the future's status: if its worker has died since, that is "lost", though the outcome is here.
            if isinstance(outcome, CancelledError):
                raise UserError(f"{self.where} is gone; what was done is kept, the same command goes on with the rest")
            if isinstance(outcome, tuple):  # kind, error, traceback
                reason = " ".join([f"{type(outcome[1]).__name__}:", *str(outcome[1]).split()])
                if isinstance(outcome[1], KilledWorker):
                    reason = "the worker died each time that it was tried: out of memory, or a crash"
                outcome = {"status": "failed", "reason": reason}
            yield futures[future], outcome
            future.release()


@contextlib.contextmanager
def pool(count, scheduler=None):
    """A context with a :class:`Dask`: the scheduler at an address, or ``count`` processes of a local cluster.

    0: a thread of this process. Raises :exc:`UserError` where the scheduler does not answer.
    """
    # Of an end of a worker or a scheduler it would print pages; what matters is in the outcomes. Workers inherit it.
    os.environ.setdefault("DASK_LOGGING__DISTRIBUTED", "critical")
    import distributed

    for name in ("distributed.client", "tornado.application"):  # they have levels of their own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        with contextlib.closing(_connected(distributed, scheduler)) as client:
            if not client.nthreads():
                note = f"note: the scheduler at {scheduler} has no workers yet; waiting for one"
                print(note, file=sys.stderr, flush=True)
            yield Dask(client, f"the scheduler at {scheduler}")
        return
    with contextlib.ExitStack() as stack:
        # No dashboard, and any free port for what is left of its server: of a second sweep beside this one, whose
        # server has the usual port, dask would warn.
        cluster = distributed.LocalCluster(
            n_workers=max(1, count), threads_per_worker=1, processes=count > 0, dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        )  # fmt: skip
        stack.callback(_close, cluster)
        client = distributed.Client(cluster)
        stack.callback(_close, client)
        if count:
            client.register_plugin(_no_interrupt(distributed))
        yield Dask(client, "the local cluster")
        # One that is just being started again would print a traceback if it were stopped now.
        with contextlib.suppress(TimeoutError):
            client.wait_for_workers(max(1, count), timeout=TIMEOUT)


def _close(what):
    """Close a cluster or client; by now all outcomes are here, so what goes wrong does no harm."""
    with contextlib.suppress(Exception):  # such as an AssertionError, where a worker is just being started again
        what.close()


def _no_interrupt(distributed):
    """A plugin by which workers leave Ctrl-C, which a terminal sends to all its processes, to the one in front."""

    class NoInterrupt(distributed.WorkerPlugin):
        def setup(self, worker):
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return NoInterrupt()


def _connected(distributed, address):
    try:
        return distributed.Client(address, timeout=TIMEOUT)
    except (OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(f"--scheduler {address}: no scheduler answers there: {reason}") from None
