"""Model of :mod:`cmfpga.rtl.shell.batch_end`."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class BatchEnds:
    """Where batches end; see the registers ``BATCH_EVENTS``, ``BATCH_DURATION`` and ``BATCH_TLAST``."""

    events: int = 0
    duration: int = 0
    by_tlast: bool = True


def split_batches(config, tokens, ends):
    """Tokens to batches.

    Parameters
    ----------
    config : Config
    tokens : iterable of Token
        As :func:`~cmfpga.reference.wire.decoders.sensor_gate` passes them.
    ends : BatchEnds

    Returns
    -------
    batches : list of (t, x, y, cut)
        int64 arrays; ``cut`` where the batch, or slice, became as long as one may be.
    rest : list of (t, x, y)
        Events behind the last end.
    empty_ends : int
        Ends of packets without an event in the batch.
    """
    wrap, half = 1 << config.time_bits, 1 << (config.time_bits - 1)
    batches, batch, empty = [], [], 0
    completed = False  # the last token completed the number: an end that follows at once is that batch's

    def close(cut=False):
        columns = np.array(batch, np.int64).reshape(-1, 3).T
        batches.append((*columns, cut))
        batch.clear()

    for token in tokens:
        if token.event:
            if batch and ends.duration:
                since = (token.t - batch[0][0] + half) % wrap - half
                if not -ends.duration <= since < ends.duration:
                    close()
            batch.append((token.t, token.x, token.y))
            marked = token.end and ends.by_tlast
            completed = not marked and len(batch) in (ends.events, config.slice_events)
            if marked or completed:
                close(cut=not marked and len(batch) != ends.events)
        elif token.end and ends.by_tlast:
            if batch:
                close()
            else:
                empty += not completed
            completed = False
    return batches, batch, empty
