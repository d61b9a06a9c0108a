"""``--study large``: flow where tiles are large; the tiles around take out what is wrong, and keep what is right."""

import json

import pytest

from cmfpga import cli
from studies import accuracy
from studies.accuracy import large


@pytest.mark.usefixtures("long_tools")
def test_what_is_wrong_goes_and_what_is_right_stays(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(large, "SENSORS", ((480, 360, 0.55),))
    monkeypatch.setattr(large, "FIELDS", {name: large.FIELDS[name] for name in ("zoom", "two motions")})
    told = ["--study", "large", "--batches", "1", "--seeds", "1-2", "--json", str(tmp_path / "scores.json")]
    assert cli.run(accuracy.main, told) == 0
    found = json.loads((tmp_path / "scores.json").read_text())["results"]["large, sum, 480×360, 0.55"]["scores"]
    assert found["right_before"] < 0.85 * found["before"], "the scene has tiles that are wrong"
    assert found["right_after"] > 0.9 * found["after"] and found["right_after"] > 0.85 * found["right_before"]
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert len(lines) == 2 + 3 and lines[-1].startswith("| sum")
