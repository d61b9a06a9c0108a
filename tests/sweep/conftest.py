"""Four small synthetic recordings, and the sweep of them with eight small configurations in one process."""

import pytest

from support.sweeping import OPTIONS, make_recording, run_here


@pytest.fixture(scope="session")
def recordings(tmp_path_factory):
    """Paths of four recordings; nobody writes to them."""
    folder = tmp_path_factory.mktemp("sweep")
    velocities = ((400.0, 100.0), (-300.0, 250.0), (150.0, -350.0), (-100.0, 500.0))
    paths = [folder / f"{name}.h5" for name in ("a", "b", "c", "d")]
    for seed, (path, velocity) in enumerate(zip(paths, velocities, strict=True), 1):
        made = make_recording(path, seed, velocity)
        assert len(made.events) >= 180, "three batches are needed"
    return paths


@pytest.fixture(scope="session")
def serial(recordings, tmp_path_factory):
    """``serial(engine)``: the folder of the sweep of all, row after row in one process without Dask."""
    folders = {}

    def run(engine):
        if engine not in folders:
            folder = tmp_path_factory.mktemp("serial")
            done = run_here(*recordings, *OPTIONS, "--engine", engine, "--out", folder)
            assert (done.status, done.err) == (0, "")
            folders[engine] = folder
        return folders[engine]

    return run
