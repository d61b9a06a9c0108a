"""The command ``cmfpga``: every subcommand by its name, help, completion, mistakes."""

import os
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from cmfpga import __version__, cli
from cmfpga.cli import command as tool
from cmfpga.engines import usual_preset
from cmfpga.errors import UserError

ROOT = Path(__file__).parents[2]


def test_the_entry_point():
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert scripts == {"cmfpga": "cmfpga.cli.command:entry"}


def run(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "cmfpga", *map(str, arguments)], capture_output=True, text=True,
        timeout=120, env={**os.environ, **environment},
    )  # fmt: skip


def test_without_arguments_it_helps_and_fails():
    done = run("--help")
    assert done.returncode == 0 and done.stderr == ""
    assert all(f"  {name:<10} {purpose}\n" in done.stdout for name, purpose in tool.COMMANDS.items())
    assert all(example in done.stdout for example in tool.EXAMPLES)
    alone = run()
    assert alone.returncode == 2 and alone.stdout == done.stdout
    assert run("--version").stdout == f"cmfpga {__version__}\n"


@pytest.mark.parametrize("name", tool.COMMANDS)
def test_every_subcommand_helps_with_examples(name, command):
    module = tool.load(name)
    here, there = command(tool, name, "--help"), command(module, "--help")
    assert here == there and here.status == 0
    assert here.out.startswith(f"usage: cmfpga {name} ")
    assert command(module, "--version").out == f"cmfpga {__version__}\n"
    for example in module.EXAMPLES:
        assert example.startswith("cmfpga ") and f"  {example}\n" in here.out
        words = shlex.split(example.rpartition("&& ")[2], comments=True)
        if "--list-fields" in words:
            continue  # which ends with the list
        options = tool.load(words[1]).parser().parse_args(words[2:])
        if words[1] == "track":
            options.preset = options.preset or usual_preset(cli.config_changes(options), engine="model")[0]
            cli.make_config(options)


def test_nothing_is_loaded_for_help():
    program = (
        "import sys; from cmfpga.cli import command\n"
        "try: command.main(['--help'])\nexcept SystemExit: pass\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"numpy", "torch", "amaranth", "matplotlib", "cmfpga.cli.track"} & set(done.stderr.split())


@pytest.mark.parametrize("arguments, message", [
    (["trak"], "'trak': no such subcommand; did you mean 'track'? One of "),
    (["xyz"], "'xyz': no such subcommand; one of "),
    ([""], "'': no such subcommand; one of "),
    (["--foo"], "--foo: a subcommand is needed first: "),
    (["--version=3"], "argument --version: ignored explicit argument '3' (--help lists the options)"),
    (["--print-completion"], "argument --print-completion: expected one argument"),
    (["--print-completion", "fish"], "argument --print-completion: invalid choice: 'fish'"),
    (["track", "missing.h5", "--roi", "1,2"], "missing.h5: no such file"),
])  # fmt: skip
def test_mistakes(command, arguments, message):
    done = command(tool, *arguments)
    assert done.error.startswith(message) and done.out == ""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    pytest.importorskip("shtab")
    path = tmp_path_factory.mktemp("completion") / "cmfpga.bash"
    path.write_text(run("--print-completion", "bash").stdout)
    return path


@pytest.mark.parametrize("words, expected", [
    (["tr"], ["track"]), (["--vers"], ["--version"]), (["build", "--res"], ["--resources"]),
    (["track", "rec"], ["rec.h5"]), (["track", "--engine", ""], ["rtl", "model", "float", "axi"]),
])  # fmt: skip
def test_bash(script, tmp_path, words, expected):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash")
    (tmp_path / "rec.h5").touch()
    asked = 'COMP_WORDS=(cmfpga "$@"); COMP_CWORD=$#; _shtab_cmfpga; printf "%s\\n" "${COMPREPLY[@]}"'
    asked = [bash, "-c", f"source {script}; {asked}", "bash", *words]
    done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == expected, done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_every_shell_knows_every_subcommand(command, shell):
    pytest.importorskip("shtab")
    done = command(tool, "--print-completion", shell)
    assert (done.status, done.err) == (0, "")
    for name in tool.COMMANDS:
        assert name in done.out


def test_shtab_is_asked_for(monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    with pytest.raises(UserError, match=r"pip install 'cmfpga\[completion\]'"):
        tool.main(["--print-completion", "bash"])


def test_values_that_begin_with_a_minus():
    made = cli.parser("mine", "Mine.", [])
    made.add_argument("--roi", type=cli.pair("X,Y"))
    made.add_argument("--flag", action="store_true")
    made.add_argument("name", nargs="?")
    for arguments in (["--roi", "-1,5"], ["--roi=-1,5"], ["--flag", "--roi", "-1,5"]):
        assert made.parse_args(arguments).roi == (-1, 5)
    assert made.parse_args(["--roi", "-1,-5", "a"]).name == "a"
    for arguments in (["--flag", "-1"], ["--roi", "--flag"], ["--roi=--"], ["--roi", "-x"]):
        with pytest.raises(UserError, match=r"\(--help lists the options\)$"):
            made.parse_args(arguments)


def test_every_subcommand_is_documented():
    text = (ROOT / "docs" / "command.md").read_text(encoding="utf-8")
    rows = [line.split("`")[1] for line in text.splitlines() if line.startswith("| `cmfpga ")]
    assert sorted(rows) == sorted(f"cmfpga {name}" for name in tool.COMMANDS)
