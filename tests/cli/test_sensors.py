"""``info``, ``track`` and ``flow`` without an option on the sensors that are sold: what they find is there."""

import json
import shlex

import numpy as np
import pandas
import pytest

from cmfpga.cli import flow, generate, info, track

SIZES = [(320, 320), (346, 260), (640, 480), (1280, 720), (1280, 800)]
VELOCITY = np.array([120.0, -40.0])
MODEL = ("--engine", "model", "--no-picture")


@pytest.fixture
def scene(command, tmp_path):
    """``scene(width, height)``: an object of 40×40 px in noise."""

    def made(*size):
        told = ["--sensor", "{},{}".format(*size), "--velocity", "{:g},{:g}".format(*VELOCITY), "--noise", 0.1]
        assert command(generate, tmp_path / "rec.h5", *told, "--duration-us", 200_000).status == 0
        return tmp_path / "rec.h5"

    return made


def right(folder, half_s):
    """All of ``track.csv`` are to be trusted, and right within 0.6 px per half batch or window."""
    rows = pandas.read_csv(folder / "track.csv")
    off = np.hypot(rows.vx_px_per_s - VELOCITY[0], rows.vy_px_per_s - VELOCITY[1]) * half_s
    return (rows.trusted == 1).all() and (off < 0.6).all()


def test_what_info_proposes_is_trusted_as_it_says(command, scene, tmp_path):
    (found,) = json.loads(command(info, scene(*SIZES[3]), "--check", 2, "--json").out)["proposals"]
    assert all(3 <= px <= 5 for px in found["checked_px_per_half_batch"]) and found["checked_trusted"] == [True] * 2
    done = command(track, *shlex.split(found["command"])[2:], *MODEL, "--batches", 2, "--out", tmp_path)
    assert done.status == 0 and right(tmp_path, found["batch_us"] / 2e6)


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("size", SIZES)
def test_without_an_option(command, scene, tmp_path, size):
    path = scene(*size)
    done = command(track, path, "--roi", "auto", *MODEL, "--json", "--out", tmp_path)
    told = json.loads(done.out)
    assert done.status == 0 and told["batches"] > 20
    speed = np.hypot(*VELOCITY)
    assert right(tmp_path, told["median_px_per_half_batch"] / speed)
    done = command(flow, path, *MODEL, "--json", "--windows", 2, "--out", tmp_path)
    told = json.loads(done.out)
    # Tiles of 48 px are larger than the object: too few see it to bear one another out.
    fewest = 3 if size[0] <= 640 else 0
    assert done.status == 0 and 3 <= told["moved_px"] <= 6 and told["measured"] >= 3 and told["trusted"] >= fewest
    with np.load(tmp_path / "flow.npz") as arrays:
        half_s = (arrays["t"][:, 1] - arrays["t"][:, 0])[:, None] / 2e6
        off = np.hypot(*np.moveaxis(arrays["v"] - VELOCITY, -1, 0)) * half_s
        trusted = off[arrays["trusted"] != 0]
        assert len(trusted) == told["trusted"] and (not len(trusted) or np.median(trusted) < 0.8)
