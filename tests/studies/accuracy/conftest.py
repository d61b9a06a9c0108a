"""The batches of the suites, made once."""

import pytest
from studies.accuracy.real import real_cases
from studies.accuracy.synthetic import synthetic_cases


@pytest.fixture(scope="session")
def synthetic():
    return synthetic_cases()


@pytest.fixture(scope="session")
def real(data_dir):
    return real_cases(data_dir)
