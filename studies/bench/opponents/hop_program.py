"""A hop of a window that slides in C: when it has ended, and following its events."""

import ctypes

from .c_program import CProgram, Loaded


class HopProgram(CProgram):
    """hop.c, compiled; raises :exc:`~.c_program.Unavailable` as :class:`~.c_program.CProgram` does."""

    def __init__(self, sources=None):
        super().__init__("hop", sources, includes=("int16.c",))
        self.library.hop_new.restype = ctypes.c_void_p

    def load(self, job):
        """A :class:`LoadedHop`: the job is a window."""
        return LoadedHop(self.library, job)


class LoadedHop(Loaded):
    """A window in the program, its events cropped and dithered, as they are before a hop ends."""

    def __init__(self, library, job):
        super().__init__(library, job)
        self.batch()  # without iterations: crops and dithers
        self._hop = ctypes.c_void_p(library.hop_new(ctypes.byref(self._job)))
        if not self._hop:
            raise MemoryError("no memory for four images")
        self.follow()

    def round(self, count=1):
        """What is left when the hop has ended, where nothing followed: times, four gradients, a step. Returns v."""
        return self._run(self._library.run_round, count)

    def follow(self, count=1):
        """All of the window's events but the last one, one after the other, into the sums of four evaluations."""
        self._library.run_follow(self._hop, self._work, ctypes.byref(self._job), ctypes.c_int64(count))

    def tail(self, count=1):
        """What is left when the closing event comes, after :meth:`follow`: that event, and a step. Returns v."""
        self._library.run_tail(self._hop, self._work, ctypes.byref(self._job), ctypes.c_int64(count))
        return tuple(self._job.v)

    def close(self):
        """Free what the window holds."""
        if self._hop:
            self._library.hop_free(self._hop)
            self._hop = None
        super().close()
