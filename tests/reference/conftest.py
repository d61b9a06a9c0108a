"""What the tests of the references share."""

import pytest
import torch


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    """On such small tensors more threads are slower."""
    torch.set_num_threads(1)
