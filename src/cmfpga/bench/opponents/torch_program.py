"""The float64 reference in PyTorch as a program: what all others are compared with, on the CPU and on a GPU.

It is as it stands in :mod:`cmfpga.reference.floating`: written to be read, not tuned. On the CPU it has one thread,
because tensors this small only get slower with more.
"""

import contextlib
import time

import numpy as np

from .job import Loaded, Program, Unavailable


class TorchProgram(Program):
    """The reference on ``device``.

    Raises
    ------
    Unavailable
        PyTorch is not installed, or has no such device.
    """

    def __init__(self, device="cpu"):
        try:
            import torch
        except ModuleNotFoundError as error:
            if error.name != "torch":
                raise
            raise Unavailable(
                "PyTorch is not installed (pip install 'cmfpga[reference]'): no PyTorch programs"
            ) from None
        if device == "cuda" and not torch.cuda.is_available():
            raise Unavailable("no CUDA device: no PyTorch program on a GPU")
        self.device = torch.device(device)
        where = f"CUDA ({torch.cuda.get_device_name()})" if device == "cuda" else "one thread"
        self.name = f"PyTorch float64, {where if device == 'cuda' else 'CPU'}"
        self.is_reference = device == "cpu"
        if device != "cpu":
            self.clock = time.perf_counter  # the thread sleeps while the device works
        self.how = f"torch {torch.__version__}, {where}, eager"

    def load(self, job):
        return _LoadedTorch(self.device, job)


@contextlib.contextmanager
def _one_thread():
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class _LoadedTorch(Loaded):
    def __init__(self, device, job):
        import torch

        self._device = device
        self._job = job
        events = (job.events.t, job.events.x.astype(np.int64), job.events.y.astype(np.int64))
        self._events = [torch.from_numpy(np.array(a)).to(device) for a in events]

    def batch(self, count=1):
        with _one_thread():
            for _ in range(count):
                self._crop()
                v = self._ascend()
        return v

    def ascent(self, count=1):
        with _one_thread():
            for _ in range(count):
                v = self._ascend()
        return v

    def gradient(self, v, level=0):
        import torch

        from ...reference.floating import evaluate

        job = self._job
        v = torch.tensor(v, dtype=torch.float64, device=self._device)
        now = evaluate(*self._scaled(), v, width=job.width, height=job.height, level=level)
        pixels = job.width * job.height
        return float(now.g_x) / pixels, float(now.g_y) / pixels

    def _crop(self):
        from ...reference.floating import dither

        job = self._job
        t, x, y = self._events
        x, y = x - job.roi[0], y - job.roi[1]
        inside = (x >= 0) & (x < job.width) & (y >= 0) & (y < job.height)
        t, x, y = t[inside], x[inside], y[inside]
        if job.dither:
            x, y = (axis + offset.to(axis.device) for axis, offset in zip((x, y), dither(len(x)), strict=True))
        self._cropped = (t, x, y)

    def _scaled(self):
        from ...reference.floating import scaled_times

        t, x, y = self._cropped
        first, last = self._events[0][[0, -1]].tolist()
        return x, y, scaled_times(t, first, last)

    def _ascend(self):
        """v as numbers: on a GPU this waits for the result."""
        from ...reference.float_ascent import ascend, ascend_by_signs

        job = self._job
        t = self._events[0]
        if not len(self._cropped[0]) or t[0] == t[-1]:
            return tuple(map(float, job.v_start))
        options = {"width": job.width, "height": job.height, "v_start": job.v_start}
        if job.schedule is None:
            steps = ascend(*self._scaled(), **options, eta=job.eta, iterations=job.iterations)
        else:
            steps = ascend_by_signs(*self._scaled(), **options, schedule=job.schedule)
        return tuple(steps.v[-1].tolist())


MAKERS = (TorchProgram, lambda: TorchProgram("cuda"))
