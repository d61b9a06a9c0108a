"""What the tests of the emitted Verilog share."""

import sys
from pathlib import Path

import pytest

SIM = Path(__file__).parents[2] / "sim"
sys.path.insert(0, str(SIM))  # make_vectors


@pytest.fixture(scope="session")
def sim_dir():
    return SIM
