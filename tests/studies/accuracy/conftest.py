"""The batches of the suites, made once; and the command."""

import json

import pytest
from studies.accuracy.real import real_cases
from studies.accuracy.synthetic import synthetic_cases

from cmfpga import cli
from studies import accuracy


@pytest.fixture(scope="session")
def synthetic():
    return synthetic_cases()


@pytest.fixture(scope="session")
def real(data_dir):
    return real_cases(data_dir)


@pytest.fixture
def run(monkeypatch):
    """A function that runs the command, without the environment's folder of recordings; returns the exit status."""
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    return lambda *arguments: cli.run(accuracy.main, [*map(str, arguments)])


@pytest.fixture
def written(run, tmp_path):
    """A function that runs the command; returns what ``--json`` writes."""

    def written(*arguments):
        file = tmp_path / "scores.json"
        assert run(*arguments, "--json", file) == 0
        return json.loads(file.read_text())

    return written
