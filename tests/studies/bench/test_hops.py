"""``bench --hops``: cycles from a hop's last event to its result, in the Verilog, are those of the formula."""

import numpy as np
import pytest

from cmfpga import cli
from cmfpga.config import preset
from cmfpga.events import Events
from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.sliding.core import SlidingCore
from studies.bench import hops, main
from support.hops import CORNER, SMALL, drawn

CONFIG = preset("quad").replace(**SMALL)
ONE = preset("fast").replace(**SMALL | {"tag_bits": 7})  # one evaluator


@pytest.fixture
def moving(rng):
    """Without the steps back."""
    _, x, y = drawn(rng, 2000)
    return Events(np.cumsum(rng.integers(1, 40, len(x))), x, y, np.zeros(len(x)))


@pytest.mark.parametrize("config", [CONFIG, ONE], ids=["four evaluators", "one"])
def test_a_hop_that_followed_takes_the_tail(moving, config, compiler):
    """Three cycles more than from the hop's end, which is so far behind the event."""
    _, _, warm, cold, _ = hops.play(config, moving, CORNER, 100)
    core = SlidingCore(config)
    turns = 1 << config.geometry.turn_bits
    assert len(warm) > 20 and set(warm) == {core.tail + 3 - k for k in range(turns)} and cold
    assert max(cold) <= core.cycles(roi_events=120, iterations=len(BatchSettings.from_config(config).cold)) + 3


def test_events_that_come_too_fast_are_told(moving, compiler):
    row = {"recording": "drawn", **hops.row_of(*hops.play(CONFIG, moving, CORNER, 0))}
    assert row["most"] > 130 and row["within_130"] < row["warm"]
    assert f"{row['within_130']} of {row['warm']} warm hops within 130 cycles" in hops.text([row], {}, 100, 120)[-1]


def test_results_a_second_follow_from_the_cycles_between_them(compiler):
    """Of a round that follows, and of two: each replays all events, and the second begins after the result."""
    one, both = hops.rate(400, after=""), hops.rate(400)
    assert 400 < one < 600 and 800 < both < 1100
    rates = {"search alone": {400: one}}
    assert f"n = 400: {1e8 / one:,.0f} ({one} cycles)" in hops.text([], rates, 100, 800)[-1]


@pytest.mark.parametrize("arguments", [[], ["--data", "."]])
def test_without_recordings_it_says_what_it_needs(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    assert cli.run(main, ["--hops", *arguments]) == 2
    assert "--hops needs --data DIR" in capsys.readouterr().err
