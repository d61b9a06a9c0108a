"""What a terminal shows while something takes seconds."""

import contextlib
import threading

from tqdm import tqdm

_TICK_S = 0.5


@contextlib.contextmanager
def waiting(doing, total=None):
    """A line on standard error, if that is a terminal, once it takes half a second; its clock runs meanwhile.

    Gives tqdm's bar, whose ``update`` counts steps, where there are a ``total`` of them.
    """
    over = threading.Event()
    form = None if total else "{desc}: {elapsed}"
    with tqdm(desc=doing, total=total, unit="step", bar_format=form, disable=None, leave=False, delay=_TICK_S) as bar:

        def tick():
            while not over.wait(_TICK_S):
                bar.refresh()

        ticker = threading.Thread(target=tick, daemon=True)
        if not bar.disable:
            ticker.start()
        try:
            yield bar
        finally:
            over.set()
            if ticker.ident:
                ticker.join()
