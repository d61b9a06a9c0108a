"""The picture of windows that slide beside batches: ``python docs/windows.py`` draws images/sliding.png.

A scene of ``python -m studies.accuracy --moving``, which the suite measures as well: an object that turns back.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from cmfpga.config import preset
from studies.accuracy import moving

PATH = Path(__file__).parent / "images" / "sliding.png"
SCENE, SEED = moving.SCENES[5], 1


def courses():
    """``(times, true v along x, true place, {who: Course})`` of the scene."""
    made, config = SCENE.made(SEED), preset("sliding")
    count, span_us = moving.usual(made)
    start, mean = made.roi_start(moving.ROI, moving.ROI), made.motion.mean_velocity
    parts = moving.courses(config, [moving.BUILT], made.events, start, count, span_us, mean)
    found = dict(zip(("batches", "windows that slide"), parts.values(), strict=True))
    times = np.arange(0, moving.PIECE_US * SCENE.pieces, moving.STEP_US)
    return times, made.motion.velocity(times)[:, 0], made.motion.position(times), start, found


def main():
    """Draw it."""
    times, truth, place, start, found = courses()
    figure, (speed, off) = plt.subplots(
        2, 1, figsize=(10.5, 5.5), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    speed.plot(times / 1e3, truth, "k--", label="truth")
    for (who, course), color in zip(found.items(), ("tab:orange", "tab:blue"), strict=True):
        newest = course.newest(times, course.v, (np.nan, np.nan))[:, 0]
        corner = course.newest(times, course.corner, start)
        speed.plot(times / 1e3, newest, color=color, drawstyle="steps-post", label=who)
        away = np.hypot(*(corner + (moving.ROI - 1) / 2 - place).T)
        off.plot(times / 1e3, away, color=color, drawstyle="steps-post", label=who)
    speed.set(ylabel="newest velocity along x [px/s]", title="An object that turns back: what is known when")
    off.set(xlabel="time [ms]", ylabel="ROI off the object [px]")
    for axes in (speed, off):
        axes.grid(alpha=0.3)
    speed.legend(loc="upper left", bbox_to_anchor=(1, 1))
    figure.savefig(PATH, dpi=110)
    print(f"wrote {PATH}")


if __name__ == "__main__":
    main()
