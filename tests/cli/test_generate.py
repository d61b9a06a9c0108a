"""``cmfpga generate``: the file holds the scene, its truth, and K of it if asked."""

import dataclasses
import json

import h5py
import numpy as np
import pytest

from cmfpga.cli import generate
from cmfpga.events import Events
from cmfpga.events import generate as make_scene
from support.recordings import assert_reads


def test_what_is_written_is_the_scene(command, tmp_path):
    path = tmp_path / "scene.h5"
    told = "--seed 5 --sensor 64,48 --texture dense --size 16,12 --position 20.5,30 --velocity -40,25.5"
    more = "--duration-us 200000 --contrast 0.5 --noise 0.2 --hot-pixels 3 --hot-rate 500"
    done = command(generate, path, *told.split(), *more.split())
    expected = make_scene(
        seed=5, width=64, height=48, texture="dense", size=(16, 12), position=(20.5, 30.0), velocity=(-40.0, 25.5),
        duration_us=200_000, contrast=0.5, noise=0.2, hot_pixels=3, hot_rate=500.0,
    )  # fmt: skip
    assert (done.status, done.err) == (0, "")
    assert done.out == f"wrote {path}: {len(expected.events):,} events in 0.2 s\n"
    recording, events = assert_reads(path, expected.events), expected.events
    assert (recording.width, recording.height, recording.time_unit_source) == (64, 48, "file")
    with h5py.File(path) as file:
        truth = file["ground_truth/motion"]
        assert truth["t"][:].tolist() == [0]
        assert truth["velocity"][:].tolist() == [[-40.0, 25.5]] and truth["velocity"].attrs["unit"] == "px/s"
        assert truth["start"][:].tolist() == [20.5, 30.0]
        assert file.attrs["num_events"] == len(events) and file.attrs["t_last_us"] == events.t[-1]


def test_over_another_recording(command, tmp_path):
    """Events of both in order of time, those of the other one first; the motion of neither is the file's."""
    one, two = tmp_path / "one.h5", tmp_path / "two.h5"
    size = {"width": 64, "height": 48, "size": (16, 12)}
    options = ["--sensor", "64,48", "--size", "16,12"]
    command(generate, one, *options, "--duration-us", 100_000)
    done = command(generate, two, *options, "--seed", 1, "--duration-us", 60_000, "--over", one, "--json")
    scenes = make_scene(duration_us=100_000, **size), make_scene(seed=1, duration_us=60_000, **size)
    expected = Events.merge(scene.events for scene in scenes)
    assert len(expected) == sum(len(scene.events) for scene in scenes) and (np.diff(expected.t) >= 0).all()
    assert_reads(two, expected)
    summary = json.loads(done.out)
    assert (summary["events"], summary["duration_us"]) == (len(expected), int(expected.t[-1]) + 1)
    with h5py.File(two) as file:
        assert "ground_truth" not in file


@pytest.mark.parametrize("options, message", [
    (["--over", "one.h5"], "--over one.h5: a sensor of 64×48 px; 240×180 is needed"),
    (["--over", "one.txt"], "--over one.txt: a sensor of no size; 240×180 is needed"),
    (["--over", "none.h5"], "none.h5: no such file"),
    (["--over", "one.h5", "--sensor", "64,48", "--repeat", 2], "--over: it goes without --repeat"),
])  # fmt: skip
def test_what_cannot_be_laid_over(command, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    command(generate, "one.h5", "--sensor", "64,48", "--size", "16,12", "--duration-us", 50_000)
    (tmp_path / "one.txt").write_text("0.001 3 4 1\n0.002 4 4 1\n")
    assert command(generate, "two.h5", *options).error == message


def test_there_and_back_again(command, tmp_path):
    path = tmp_path / "scene.h5"
    told = ["--velocity", "60,0", "--duration-us", 100_001, "--there-and-back", "--repeat", 3, "--json"]
    done = command(generate, path, *told)
    once = make_scene(velocity=((50_000, 60.0, 0.0), (50_001, -60.0, 0.0)), duration_us=100_001)
    assert json.loads(done.out) == {
        "file": str(path), "events": 3 * len(once.events), "duration_us": 300_003, "sensor": [240, 180],
        "velocity_px_per_s": [[0, 60.0, 0.0], [50_000, -60.0, 0.0]], "start_px": [119.5, 89.5],
    }  # fmt: skip
    parts = (dataclasses.replace(once.events, t=once.events.t + k * 100_001) for k in range(3))
    assert assert_reads(path, Events.concatenate(parts)).num_events == 3 * len(once.events)
    with h5py.File(path) as file:
        assert file["ground_truth/motion/t"][:].tolist() == [0, 50_000, 100_001, 150_001, 200_002, 250_002]
        assert file["ground_truth/motion/velocity"][:, 0].tolist() == [60.0, -60.0] * 3


@pytest.mark.parametrize("arguments, message", [
    (["a.txt"], "a.txt: only HDF5 is written; a name that ends with .h5 is needed"),
    ([], "the following arguments are required: FILE"),
    (["FOLDER/a.h5"], "FOLDER/a.h5: cannot be written: No such file or directory"),
    (["a.h5", "--velocity", "1"], "argument --velocity: '1': two numbers, as in 120,-40, are needed"),
    (["a.h5", "--noise", "much"], "argument --noise: 'much': a number is needed"),
    (["a.h5", "--repeat", "0"], "argument --repeat: '0': a whole number of 1 or more is needed"),
    (["a.h5", "--sensor", "0,5"], "width = 0: 1 to 65536 is needed"),
    (["a.h5", "--velocity", "0,0"], "a.h5: no events to write"),
])  # fmt: skip
def test_mistakes(command, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    done = command(generate, *arguments)
    assert done.error.startswith(message) and done.out == ""
