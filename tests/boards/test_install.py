"""``install.sh``, below another root."""

import os
import shutil
import subprocess

import pytest

from support.board_files import BOARD


def install(folder, root, *words):
    return subprocess.run(
        ["sh", folder / "install.sh", *words], capture_output=True, text=True, timeout=60,
        env={**os.environ, "ROOT": str(root)},
    )  # fmt: skip


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "package"
    folder.mkdir()
    for name in ("shell.json", "uio.conf", "install.sh"):
        shutil.copy(BOARD / "sw" / name, folder)
    for name in ("cmfpga.bit.bin", "cmfpga.dtbo"):
        (folder / name).write_bytes(name.encode())
    return folder


def test_install_and_remove(package, tmp_path):
    root = tmp_path / "root"
    for _ in range(2):  # a second time replaces the first
        done = install(package, root)
        assert done.returncode == 0, done.stderr
        assert "xmutil loadapp cmfpga" in done.stdout
        target = root / "lib/firmware/xilinx/cmfpga"
        assert {path.name for path in target.iterdir()} == {"cmfpga.bit.bin", "cmfpga.dtbo", "shell.json"}
        assert [path.name for path in target.parent.iterdir()] == ["cmfpga"]
        options = root / "etc/modprobe.d/cmfpga-uio.conf"
        assert options.read_text(encoding="utf-8").endswith("of_id=generic-uio\n")
    assert install(package, root, "--remove").returncode == 0
    assert not target.exists() and not options.exists()


@pytest.mark.parametrize("missing", ["cmfpga.bit.bin", "cmfpga.dtbo", "shell.json", "uio.conf"])
def test_install_names_what_is_missing(missing, package, tmp_path):
    (package / missing).unlink()
    done = install(package, tmp_path / "root")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and missing.removeprefix("cmfpga") in done.stderr
    assert not (tmp_path / "root").exists()


def test_install_refuses_an_unknown_option(package, tmp_path):
    done = install(package, tmp_path / "root", "--force")
    assert done.returncode == 2 and "unknown option --force" in done.stderr
