"""Random configurations: a short run of the command, and that it sees what is wrong."""

import contextlib
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from studies.crosscheck.configs import assignments, kind_of, random_config

from cmfpga import cli
from cmfpga.config import ASCENTS, GRADIENTS, Config
from cmfpga.reference.integer import core as model
from studies import crosscheck


def outcome(capsys, *arguments):
    status = crosscheck.main([*arguments, "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_random_configurations(capsys, monkeypatch):
    """With what was compiled for an earlier run, which the command would not keep (it does so in ``tests/docs``)."""
    monkeypatch.setattr(crosscheck, "_own_cache", lambda: contextlib.nullcontext(Path("nothing")))
    status, found = outcome(capsys, "--configs", "3", "--seed", "43")
    assert (status, found["findings"]) == (0, [])
    assert found["configurations"] == 3 and found["with_regions"] == 1 and not found["with_shell"]
    assert found["batches"] > 60 and found["iterations"] > 100 and found["refused"]


def test_all_of_a_configuration_is_drawn(compiler):
    kinds = [kind_of(seed) for seed in range(300)]
    assert [sum(kind[name] for kind in kinds) for name in ("regions", "shell")] == [100, 60]
    assert any(all(kind.values()) for kind in kinds)
    drawn = [random_config(np.random.default_rng(seed), **kind)[0] for seed, kind in enumerate(kinds)]
    seen = {name: {getattr(config, name) for config in drawn} for name in Config().to_dict()}
    assert [name for name, values in seen.items() if len(values) == 1] == []
    with_regions = [config for config in drawn if config.regions]
    assert sum(config.max_batch_events <= 15 for config in with_regions) > 10
    assert any(config.units > config.regions for config in with_regions)
    assert {(config.gradient, config.ascent, config.buffers) for config in drawn} == {
        (gradient, ascent, buffers)
        for gradient in GRADIENTS for ascent in ASCENTS for buffers in (1, 2)
        if gradient == "one_pass" or ascent == "constant"
    }  # fmt: skip
    assert any(config.roi_width % 2 and config.roi_height % 2 for config in drawn)
    for config in drawn[:20]:  # what is printed makes the same configuration
        changes = re.findall(r"--set '(.*?)'", assignments(config))
        assert Config(**Config.parse(changes)) == config


@pytest.fixture
def no_compiler(monkeypatch):
    crosscheck = "studies.crosscheck."
    for module in ("cmfpga.verilog.compiler", "cmfpga.engines", f"{crosscheck}compare", f"{crosscheck}configs"):
        monkeypatch.setattr(f"{module}.cannot_compile", lambda: "no C++ compiler found")
    monkeypatch.setattr("studies.crosscheck.compare.SLOW_CYCLES", 5_000)


def test_without_a_compiler(no_compiler, capsys):
    before = dict(os.environ)
    status, found = outcome(capsys, "--configs", "1", "--seed", "174")
    assert dict(os.environ) == before
    assert (status, found["findings"], found["engine"]) == (0, [], "amaranth")
    assert found["batches"] > 2 and found["iterations"]


def test_a_difference_is_found_and_can_be_repeated(no_compiler, capsys, monkeypatch):
    """One unit in one sum, once."""
    right = model.gradient_reader

    def wrong(images):
        sums = right(images)
        return sums._replace(i=sums.i + 1) if sums.i > 0 else sums

    monkeypatch.setattr(model, "gradient_reader", wrong)
    assert crosscheck.main(["--configs", "1", "--seed", "174"]) == 1
    said = capsys.readouterr().out
    assert re.match(r"MismatchError: batch \d+ \(\w+\): [\w.\[\]]+: rtl .*, model .*\n  configuration: --p", said)
    assert "\n  again: python -m studies.crosscheck --configs 1 --seed 174\n" in said
    assert "1 mismatches, 0 trace" in said


def test_a_traceback_is_a_finding(no_compiler, capsys, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(model, "gradient_reader", fail)
    status, found = outcome(capsys, "--configs", "1", "--seed", "174")
    assert (status, found["mismatches"], found["tracebacks"]) == (1, 0, 1)
    assert "on purpose" in found["findings"][0]["traceback"]


def test_interrupted_it_says_what_it_has(monkeypatch, capsys):
    outcomes = iter([np.array([3, 40]), KeyboardInterrupt])

    def check(config, seed, shell):
        if (outcome := next(outcomes)) is KeyboardInterrupt:
            raise outcome
        return outcome

    monkeypatch.setattr("studies.crosscheck.compare.check", check)
    assert cli.run(crosscheck.main, ["--configs", "500"]) == 130
    said = capsys.readouterr()
    assert said.out.startswith("1 configurations (") and " 3 batches, 40 iterations: 0 mismatches" in said.out
    assert said.err.endswith("interrupted\n")
