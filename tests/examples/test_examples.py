"""The programs in examples/ run as they say, and what they print is right."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cmfpga.cli import track
from cmfpga.events import generate, write_hdf5

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name, folder, *arguments):
    done = subprocess.run(
        [sys.executable, "-W", "error", EXAMPLES / name, *arguments], cwd=folder, capture_output=True, text=True,
        encoding="utf-8", timeout=300, env={**os.environ, "MPLCONFIGDIR": str(folder), "PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_track_and_plot(tmp_path):
    lines = run("track_and_plot.py", tmp_path).splitlines()
    assert lines[-1] == "wrote track_and_plot.png"
    assert (tmp_path / "track_and_plot.png").read_bytes().startswith(b"\x89PNG")
    rows = [list(map(float, line.split())) for line in lines[1:-2]]
    assert len(rows) >= 4
    # Before the corner and behind it.
    for row in (rows[0], rows[-1]):
        assert (row[3] > 0) == (row[1] > 0) and (row[4] > 0) == (row[2] > 0)
    assert rows[0][2] > 0 > rows[-1][2]


def test_block_in_a_design(tmp_path):
    found = re.fullmatch(
        r"(\d+) events in, (\d+) of hot pixels left out, (\d+) passed: as NumPy says\n",
        run("block_in_a_design.py", tmp_path),
    )
    events, dropped, passed = map(int, found.groups())
    assert events == dropped + passed and dropped > 100 and passed > 100


def test_word_widths(tmp_path):
    out = run("word_widths.py", tmp_path, str(tmp_path))
    errors, words = (
        [line.split() for line in table.splitlines()[1:] if re.match(r"\d+ ", line)]
        for table in out[out.index("Median error") :].split("\n\n")
    )
    assert [row[0] for row in errors] == [row[0] for row in words] == ["1", "2", "4", "8"]
    assert all(0 < float(cell) < 0.5 for row in errors for cell in row[1:])
    # A tag of 7 bits; 2047 events of weight 1 in I, and of ±1 in Dx and Dy.
    bits = (1, 2, 4, 8)
    for vote, row in zip(bits, words, strict=True):
        assert [int(cell) for cell in row[1:]] == [7 + (11 + vote) + 2 * (12 + derivative) for derivative in bits]


def test_send_at_its_own_speed(command, tmp_path):
    """The CSV is that of the file, and nobody waits for the track."""
    path = tmp_path / "slow.h5"
    scene = generate(seed=4, velocity=(24.0, 8.0), duration_us=3_000_000, noise=0.1)
    write_hdf5(path, scene.events, width=240, height=180)
    sending = subprocess.Popen(
        [sys.executable, EXAMPLES / "send_at_its_own_speed.py", path, "0"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    address = re.fullmatch(r"listening at (tcp://127\.0\.0\.1:\d+)\n", sending.stdout.readline())[1]
    options = ["--engine", "model", "--roi", "88,58", "--batch-events", 5000, "--no-picture", "--out"]
    live = command(track, address, *options, tmp_path / "live")
    said = re.fullmatch(r"(\d+) events of (\d\.\d+) s sent in (\d+\.\d+) s\n", sending.communicate(timeout=60)[0])
    assert int(said[1]) == len(scene.events) and float(said[3]) >= float(said[2])
    assert live.status == 0 and command(track, path, *options, tmp_path / "file").status == 0
    assert (tmp_path / "live" / "track.csv").read_bytes() == (tmp_path / "file" / "track.csv").read_bytes()
    assert f"{len(scene.events)} events came, 0 were dropped; the sender was held up for 0 s\n" in live.out


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_each_is_short_and_tested(path):
    assert re.search(rf'(run\(|EXAMPLES / )"{path.name}"', Path(__file__).read_text())
    assert len(path.read_text().splitlines()) <= 100
    extras = {"track_and_plot": "[reference]", "word_widths": "[reference,sweep]"}
    assert extras.get(path.stem, "no extra") in "".join(path.read_text().splitlines()[:3])  # what it needs
