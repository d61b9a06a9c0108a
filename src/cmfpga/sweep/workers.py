"""Where the tasks of a sweep run: on a local Dask cluster, or on a Dask scheduler that is there already."""

import contextlib
import logging
import os
import signal
import sys

from ..errors import ConfigError, UserError

#: How long a scheduler may take to answer, s.
TIMEOUT = 10


def processors():
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Dask:
    """Runs tasks on the workers of a Dask scheduler, in any order."""

    def __init__(self, client, where):
        self.client = client
        self.where = where

    def run(self, function, jobs):
        """Yields ``(key, outcome)`` of ``function(argument)`` for each ``(key, argument)`` of ``jobs``.

        A worker that dies loses nothing: what it had is run by another one.
        """
        from distributed import CancelledError, as_completed

        futures = {
            self.client.submit(function, argument, key=f"cmfpga-{key}", pure=False): key
            for key, argument in jobs.items()
        }
        for future, outcome in as_completed(futures, with_results=True, raise_errors=False):
            # Not by the future's status: if its worker has died since, that is "lost", though the outcome is here.
            if isinstance(outcome, CancelledError):
                raise UserError(f"{self.where} is gone; what was done is kept, the same command goes on with the rest")
            if isinstance(outcome, tuple):  # kind, error, traceback
                outcome = {"status": "failed", "reason": _reason(outcome[1])}
            yield futures[future], outcome
            future.release()


def _reason(error):
    """Why a task has no outcome, which it gives for any error of its own."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "the worker died each time that it was tried: out of memory, or a crash"
    return " ".join([f"{type(error).__name__}:", *str(error).split()])


@contextlib.contextmanager
def pool(count, scheduler=None):
    """A context with a :class:`Dask`.

    Parameters
    ----------
    count : int
        Processes of a local cluster; 0: a thread of this process.
    scheduler : str, optional
        Address of a Dask scheduler; ``count`` is not used then.

    Raises
    ------
    UserError
        Dask is not installed, or the scheduler does not answer.
    """
    # Of an end of a worker or a scheduler it would print pages; what matters is in the outcomes. Workers inherit it.
    os.environ.setdefault("DASK_LOGGING__DISTRIBUTED", "critical")
    try:
        import distributed
    except ModuleNotFoundError:
        raise ConfigError("sweep: dask is not installed; pip install 'cmfpga[sweep]'") from None
    for name in ("distributed.client", "tornado.application"):  # they have levels of their own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        with _connected(distributed, scheduler) as client:
            yield Dask(client, f"the scheduler at {scheduler}")
        return
    with contextlib.ExitStack() as stack:
        # No dashboard, and any free port for what is left of its server: of a second sweep beside this one, whose
        # server has the usual port, dask would warn.
        anywhere = {"dashboard_address": "127.0.0.1:0"}
        cluster = distributed.LocalCluster(
            n_workers=max(1, count), threads_per_worker=1, processes=count > 0, dashboard_address=None,
            scheduler_kwargs=anywhere,
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


@contextlib.contextmanager
def _connected(distributed, address):
    try:
        client = distributed.Client(address, timeout=TIMEOUT)
    except (OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(f"--scheduler {address}: no scheduler answers there: {reason}") from None
    with contextlib.closing(client):
        if not client.nthreads():
            print(f"note: the scheduler at {address} has no workers yet; waiting for one", file=sys.stderr, flush=True)
        yield client
