"""What the tests of the emitted Verilog share."""

import sys
from pathlib import Path

import pytest
import torch

SIM = Path(__file__).parents[2] / "sim"
sys.path.insert(0, str(SIM))  # make_vectors


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    """On such small tensors more threads are slower."""
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def sim_dir():
    """The folder of the test bench."""
    return SIM
