"""Where the tasks of a sweep run: in this process, on a local cluster, or on a scheduler that is there already."""

import contextlib
import logging
import os

from ..errors import ConfigError, UserError

#: How long a scheduler may take to answer, and to have a worker, s.
TIMEOUT = 10


def processors():
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Here:
    """Runs tasks one after the other in this process."""

    def run(self, function, jobs):
        """Yields ``(key, outcome)`` of ``function(argument)`` for each ``(key, argument)`` of ``jobs``."""
        for key, argument in jobs.items():
            yield key, function(argument)


class Dask:
    """Runs tasks on the workers of a Dask scheduler; the same interface as :class:`Here`, in any order."""

    def __init__(self, client, where):
        self.client = client
        self.where = where

    def run(self, function, jobs):
        """As of :class:`Here`. A worker that dies loses nothing: what it had is run by another one."""
        from distributed import CancelledError, as_completed

        futures = {
            self.client.submit(function, argument, key=f"cmfpga-{key}", pure=False): key
            for key, argument in jobs.items()
        }
        for future, outcome in as_completed(futures, with_results=True, raise_errors=False):
            if isinstance(outcome, CancelledError) or future.status in ("cancelled", "lost"):
                raise UserError(
                    f"{self.where} is gone; what was done is kept, and the same command goes on with the rest"
                )
            if future.status == "error":
                # Not an error of the task, which would be an outcome: its worker died again and again, or could not
                # even read it.
                error = future.exception()
                outcome = {"status": "failed", "reason": " ".join([f"{type(error).__name__}:", *str(error).split()])}
            yield futures[future], outcome
            future.release()


@contextlib.contextmanager
def workers(count, scheduler=None):
    """A context with a :class:`Here` or :class:`Dask`.

    Parameters
    ----------
    count : int
        Processes of a local cluster; 0: this process.
    scheduler : str, optional
        Address of a Dask scheduler; ``count`` is not used then.

    Raises
    ------
    UserError
        Dask is not installed, or the scheduler does not answer or has no workers.
    """
    if not count and scheduler is None:
        yield Here()
        return
    try:
        import distributed
    except ModuleNotFoundError:
        raise ConfigError(
            "sweep: dask is not installed; pip install 'cmfpga[sweep]' (--workers 0 does without)"
        ) from None
    # Of a worker's end it would print pages; what matters is in the outcomes.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if scheduler is not None:
        with _connected(distributed, scheduler) as client:
            yield Dask(client, f"the scheduler at {scheduler}")
        return
    cluster = distributed.LocalCluster(
        n_workers=count, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
    )
    with cluster, distributed.Client(cluster) as client:
        yield Dask(client, "the local cluster")


@contextlib.contextmanager
def _connected(distributed, address):
    try:
        client = distributed.Client(address, timeout=TIMEOUT)
    except (OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(f"--scheduler {address}: no scheduler answers there: {reason}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
        except TimeoutError:
            raise ConfigError(f"--scheduler {address}: it has no workers") from None
        yield client
