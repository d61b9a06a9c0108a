"""The same two forms in Python, compiled by numba: one thread, float32, sums in any order."""

import functools

import numpy as np

from ...config.schedule import FEWEST
from .job import Loaded, Program, Unavailable

#: Room around the image, px, where votes from outside fall.
BORDER = 2


class NumbaProgram(Program):
    """``form`` by numba.

    Raises
    ------
    Unavailable
        numba is not installed.
    """

    def __init__(self, form):
        try:
            import numba
        except ModuleNotFoundError as error:
            if error.name != "numba":
                raise
            raise Unavailable("numba is not installed (pip install 'cmfpga[bench]'): no numba programs") from None
        self.name = f"numba, {form}"
        self.how = f"numba {numba.__version__}, fastmath"
        self._functions = _compiled(form)

    def load(self, job):
        return _LoadedNumba(*self._functions, job)


class _LoadedNumba(Loaded):
    def __init__(self, run, gradient, job):
        self._run_function, self._gradient_function = run, gradient
        events = job.events
        n = len(events)
        schedule = job.schedule or ()
        self._job = (
            *(np.ascontiguousarray(a) for a in (events.t, events.x, events.y)),
            *job.roi, job.width, job.height, job.iterations, job.dither,
            np.array([entry.level for entry in schedule], np.int32),
            np.array([2.0**entry.log2_step for entry in schedule], np.float64),
            np.array([entry.stride for entry in schedule], np.int32),
            float(job.eta),
        )  # fmt: skip
        self._size = (job.width, job.height)
        self._v_start = np.array(job.v_start, np.float64)
        self._v = np.zeros(2)
        self._n = np.zeros(1, np.int64)
        self._events = np.zeros((3, n + 1), np.float32)
        self._part = np.zeros((3, n + 1), np.float32)
        self._since = np.zeros(n + 1, np.int32)
        self._fractions = np.zeros((2, n + 1), np.float32)
        self._address = np.zeros(n + 1, np.int32)
        self._images = np.zeros((3, (job.width + 2 * BORDER) * (job.height + 2 * BORDER)), np.float32)

    def _run(self, cropped, count):
        work = (self._events, self._part, self._since, self._fractions, self._address, self._images)
        self._run_function(*self._job, self._v_start, cropped, count, self._v, self._n, *work)
        return tuple(self._v.tolist())

    def batch(self, count=1):
        return self._run(False, count)

    def ascent(self, count=1):
        return self._run(True, count)

    def gradient(self, v, level=0):
        work = (self._events, self._fractions, self._address, self._images)
        g = self._gradient_function(int(self._n[0]), *self._size, float(v[0]), float(v[1]), level, *work)
        return tuple(map(float, g))


@functools.cache
def _compiled(form):
    """``(run, gradient)`` of a form; compiled at their first call."""
    from numba import njit

    jit = njit(fastmath=True, error_model="numpy", nogil=True)
    gradient = jit({"literal": _literal, "gather": _gather}[form])

    @jit
    def crop(t, x, y, roi_x, roi_y, width, height, dither, events, since):
        n = 0
        for k in range(len(t)):
            column, row = np.int32(x[k]) - roi_x, np.int32(y[k]) - roi_y
            events[0, n], events[1, n] = column, row
            since[n] = t[k] - t[0]
            if 0 <= column < width and 0 <= row < height:
                n += 1
        if dither:  # as in program.h; 2^31 taken away in float, because numba's integers do not overflow
            unit = 1.0 / (1 << 32)
            for k in range(n):
                events[0, k] += ((1621087444 + k * 3242174889) & 0xFFFFFFFF) * unit - 0.5
                events[1, k] += ((1223722707 + k * 2447445414) & 0xFFFFFFFF) * unit - 0.5
        return n

    @jit
    def run(
        t, x, y, roi_x, roi_y, width, height, iterations, dither, levels, steps, strides, eta, v_start, cropped, count,
        v, number, events, part, since, fractions, address, images,
    ):  # fmt: skip
        for _ in range(count):
            if not cropped:
                number[0] = crop(t, x, y, roi_x, roi_y, width, height, dither, events, since)
            n = number[0]
            v[0], v[1] = v_start[0], v_start[1]
            if n == 0 or t[-1] == t[0]:
                continue
            scale = np.float32(2.0 / (t[-1] - t[0]))
            for k in range(n):
                events[2, k] = since[k] * scale - np.float32(1)
            rate = 2.0 * eta / (width * height)
            for k in range(iterations):
                level = levels[k] if len(levels) else np.int32(0)
                stride = strides[k] if len(levels) else np.int32(1)
                while stride > 1 and n < FEWEST * stride:
                    stride //= 2
                used, events_used = n, events
                if stride > 1:
                    used, events_used = 0, part
                    for j in range((0, 2, 1, 3)[k % 4] * stride // 4, n, stride):
                        for axis in range(3):
                            part[axis, used] = events[axis, j]
                        used += 1
                g = gradient(used, width, height, v[0], v[1], level, events_used, fractions, address, images)
                for axis in range(2):
                    share = 0.5 if 2 * abs(g[axis]) < abs(g[1 - axis]) else 1.0
                    v[axis] += steps[k] * share * np.sign(g[axis]) if len(levels) else rate * g[axis]

    return run, gradient


def _literal(n, width, height, v_x, v_y, level, events, fractions, address, images):
    """Three images, zeroed, voted into, swept."""
    columns, rows = (width + (1 << level) - 1) >> level, (height + (1 << level) - 1) >> level
    one = np.float32(1)
    scale = one / np.float32(1 << level)
    offset = np.float32(0.5) * scale - np.float32(0.5)
    vx, vy = np.float32(v_x) * scale, np.float32(v_y) * scale
    image, by_x, by_y = images[0], images[1], images[2]
    pixels = columns * rows
    image[:pixels] = 0
    by_x[:pixels] = 0
    by_y[:pixels] = 0
    for k in range(n):
        dt = events[2, k]
        x, y = events[0, k] * scale + offset - dt * vx, events[1, k] * scale + offset - dt * vy
        i, j = np.floor(x), np.floor(y)
        fx, fy = x - i, y - j
        column, row = np.int32(i), np.int32(j)
        for corner in range(4):
            right, down = corner & 1, corner >> 1
            if 0 <= column + right < columns and 0 <= row + down < rows:
                a = (row + down) * columns + column + right
                across, along = fx if right else one - fx, fy if down else one - fy
                image[a] += across * along
                by_x[a] += -dt * along if right else dt * along
                by_y[a] += -dt * across if down else dt * across
    total = total_x = total_y = s_x = s_y = np.float32(0)
    for a in range(pixels):
        total += image[a]
        total_x += by_x[a]
        total_y += by_y[a]
        s_x += image[a] * by_x[a]
        s_y += image[a] * by_y[a]
    mean = np.float64(total) / (width * height)
    return s_x - mean * total_x, s_y - mean * total_y


def _gather(n, width, height, v_x, v_y, level, events, fractions, address, images):
    """One image with a border, read back by the events: gather.c, points 1 and 2."""
    columns, rows = (width + (1 << level) - 1) >> level, (height + (1 << level) - 1) >> level
    stride = columns + BORDER
    one, low = np.float32(1), np.float32(-BORDER)
    right, bottom = np.float32(columns), np.float32(rows)
    scale = one / np.float32(1 << level)
    offset = np.float32(0.5) * scale - np.float32(0.5)
    vx, vy = np.float32(v_x) * scale, np.float32(v_y) * scale
    x, y, dt = events[0], events[1], events[2]
    fx, fy, image = fractions[0], fractions[1], images[0]
    for k in range(n):
        px = min(max(x[k] * scale + offset - dt[k] * vx, low), right)
        py = min(max(y[k] * scale + offset - dt[k] * vy, low), bottom)
        i, j = np.floor(px), np.floor(py)
        fx[k], fy[k] = px - i, py - j
        address[k] = (np.int32(j) + BORDER) * stride + np.int32(i) + BORDER
    image[: (rows + 4) * stride + 2] = 0
    for k in range(n):
        a = address[k]
        w11 = fx[k] * fy[k]
        w10, w01 = fx[k] - w11, fy[k] - w11
        image[a] += one - fx[k] - w01
        image[a + 1] += w10
        image[a + stride] += w01
        image[a + stride + 1] += w11
    end = (rows + 2) * stride + 2
    outside = np.float32(0)
    for a in range(2 * stride + 2):
        outside += image[a]
    for a in range(end, end + 2 * stride):
        outside += image[a]
    for row in range(rows):
        outside += image[(row + 3) * stride] + image[(row + 3) * stride + 1]
    mean = np.float32((n - outside) / (width * height))
    image[: 2 * stride + 2] = mean
    image[end : end + 2 * stride] = mean
    for row in range(rows):
        image[(row + 3) * stride] = image[(row + 3) * stride + 1] = mean
    s_x = s_y = np.float32(0)
    for k in range(n):
        a = address[k]
        p00, p10, p01, p11 = image[a], image[a + 1], image[a + stride], image[a + stride + 1]
        across, down = p00 - p10, p00 - p01
        s_x += dt[k] * (across + fy[k] * (p01 - p11 - across))
        s_y += dt[k] * (down + fx[k] * (p10 - p11 - down))
    return np.float64(s_x), np.float64(s_y)


MAKERS = (lambda: NumbaProgram("gather"), lambda: NumbaProgram("literal"))
