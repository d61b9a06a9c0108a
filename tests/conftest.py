"""Fixtures that all tests share."""

import gc
import hashlib
import os
from pathlib import Path

import numpy as np
import pytest

pytest_plugins = ["support.asks", "support.small_core", "support.browser", "support.commands", "support.flowing"]

#: Rooms with tests of half a minute. They come first, so that two workers meet at short ones, and neither waits long.
LONG = ("formal", "simulation", "verilog", "driver", "docs", "cli", "accuracy")


def pytest_collection_modifyitems(items):
    def place(item):
        room = item.path.relative_to(Path(__file__).parent).parts[0]
        return LONG.index(room) if room in LONG else len(LONG)

    items.sort(key=place)


@pytest.fixture(scope="session")
def data_dir():
    """Folder of real recordings: ``CMFPGA_DATA``, or ``shared/data`` beside the repository. Skips if absent."""
    given = os.environ.get("CMFPGA_DATA")
    folder = Path(given) if given else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no folder of recordings at {folder} (set CMFPGA_DATA)")
    return folder


@pytest.fixture
def rng(request):
    """Random numbers seeded by the test's name, so that a failure can be repeated and no two tests share them."""
    digest = hashlib.sha256(request.node.nodeid.encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    """On such small tensors more threads are slower."""
    import torch

    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def _rare_collection():
    """A design is very many objects that stay: looking through them over and over takes half of its elaboration."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 10)
