"""The small recording of a dot, tracked by the model in batches of 90 events, from a file and from what sends it."""

import pytest

from cmfpga.cli import track

FOLLOW = "--engine model --roi 8,9 --batch-events 90 --no-picture --out".split()


@pytest.fixture
def follow(command, small, tmp_path):
    """``follow(source, option, …)``: its track, in the folder ``live``."""
    return lambda source, *more: command(track, source, *FOLLOW, tmp_path / "live", *small, *more)


@pytest.fixture(scope="session")
def expected(command, dot, small, tmp_path_factory):
    """``track.csv`` of the dot's file."""
    folder = tmp_path_factory.mktemp("expected")
    assert command(track, dot, *FOLLOW, folder, *small).status == 0
    return (folder / "track.csv").read_bytes()
