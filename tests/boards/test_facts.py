"""Every fact stands once, in ``board.toml``, and all files say the same."""

import copy
import json
import re
import tomllib

import pytest

from support.board_files import BOARD, KV260, ROOT
from support.vivado.interfaces import infer


def text_of(name):
    return (BOARD / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tcl():
    """``vivado/facts.tcl`` as a dictionary, read by hand."""
    lines = re.findall(r"^set fact\((\w+)\)\s+(.*)$", text_of("vivado/facts.tcl"), re.MULTILINE)
    return {name: value.strip("{}") for name, value in lines}


def test_generated_files_are_current(maker, capsys):
    assert maker.main(["--check"]) == 0, capsys.readouterr().err


def test_a_stale_file_is_named(maker, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(maker, "ROOT", tmp_path)
    for name in maker.FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    assert maker.main(["--check"]) == 1
    assert capsys.readouterr().err.count("not current: ") == len(maker.FILES)
    assert maker.main([]) == 0 and maker.main(["--check"]) == 0
    path = tmp_path / "boards/kv260/vivado/facts.tcl"
    path.write_text(path.read_text(encoding="utf-8").replace("0xa0010000", "0xa0020000"), encoding="utf-8")
    capsys.readouterr()
    assert maker.main(["--check"]) == 1
    assert capsys.readouterr().err.startswith("not current: boards/kv260/vivado/facts.tcl;")


# What the overlay says of these facts: test_device_tree.py.


def test_addresses(tcl, facts):
    for name, address, size in (
        ("cmfpga", KV260.registers_address, KV260.registers_size), ("dma", KV260.dma_address, KV260.dma_size),
    ):  # fmt: skip
        assert int(tcl[f"{name}_address"], 16) == address == facts["control"][name]["address"]
        assert int(tcl[f"{name}_size"], 16) == size == facts["control"][name]["size"]
    assert KV260.registers_size == 1 << facts["ip"]["control_address_width"]


def test_interrupt_clock_and_reset(facts):
    assert KV260.interrupt_spi == 89  # pl_ps_irq0[0], to which design.tcl connects the IP: test_vivado_scripts.py
    assert (facts["clock"]["linux_clock"], facts["clock"]["linux_reset"]) == (71, 116)
    assert KV260.linux_clock == "pl0_ref"


def test_clock(tcl, facts):
    mhz = int(tcl["clock_mhz"])
    assert KV260.clock_hz == int(tcl["clock_hertz"]) == facts["clock"]["hertz"]
    assert 0 <= mhz * 1_000_000 - KV260.clock_hz < 20 * mhz  # the PS stays below what is asked, never above
    assert f"CLOCK_MHZ := {mhz}\n" in text_of("facts.mk")
    assert "create_clock" not in text_of("vivado/kv260.xdc")


def test_names(tcl, facts):
    name, linux = facts["design"]["name"], facts["linux"]
    assert KV260.application == name == tcl["name"]
    assert (BOARD / "sw" / f"{name}.dtso").exists() and f"{name}.bit" in text_of(f"sw/{name}.bif")
    assert f"APP := {name}\n" in text_of("facts.mk")
    assert KV260.vlnv == tcl["vlnv"] == "cmfpga.org:ip:cmfpga:1.0"
    assert KV260.part == tcl["part"] == "xck26-sfvc784-2LV-c"
    assert f"PART := {KV260.part}\n" in text_of("facts.mk")
    assert (KV260.uio_registers, KV260.uio_dma) == (linux["uio_cmfpga"], linux["uio_dma"])
    assert (KV260.buffer_events, KV260.buffer_results) == (linux["buffer_events"], linux["buffer_results"])
    assert json.loads(text_of("sw/shell.json")) == {"shell_type": "XRT_FLAT", "num_slots": "1"}


def test_widths(tcl, emitted):
    interfaces, listed = infer(emitted, KV260.top), tcl["ip_interfaces"].split()
    told = {(name, i["bus"], i["mode"]) for name, i in interfaces.items()}
    assert told == {*zip(listed[::3], listed[1::3], listed[2::3], strict=True)}
    width = {(name, signal): bits for name, i in interfaces.items() for signal, (_, _, bits) in i["ports"].items()}
    for stream in ("s_axis", "m_axis"):
        assert width[stream, "TDATA"] == 8 * width[stream, "TKEEP"] == KV260.stream_width
        assert width[stream, "TUSER"] == int(tcl["stream_user_width"]) and (stream, "TLAST") in width
    assert KV260.stream_width == 8 * int(tcl["stream_bytes"])
    assert width["s_axi", "WDATA"] == width["s_axi", "RDATA"] == KV260.registers_width
    assert 1 << width["s_axi", "AWADDR"] == 1 << width["s_axi", "ARADDR"] == KV260.registers_size
    assert int(tcl["dma_data_width"]) == KV260.stream_width
    assert int(tcl["dma_length_width"]) == KV260.dma_length_bits
    assert int(tcl["dma_address_width"]) == KV260.dma_address_bits


def test_the_guide_says_the_same(facts):
    guide = text_of("README.md")
    for text in (
        KV260.part, facts["board"]["board_part"], KV260.vlnv, f"0x{KV260.registers_address:08X}",
        f"{facts['clock']['mhz']} MHz (in fact {KV260.clock_hz / 1e6:.3f} MHz)", f"SPI {KV260.interrupt_spi}",
        f"`{facts['control']['port']}` with {facts['control']['data_width']} bits",
        f"`{facts['memory']['port']}` with {facts['memory']['data_width']} bits",
        f"`/dev/{KV260.buffer_events}`\n({KV260.buffer_events_size >> 20} MiB)", f"`{KV260.uio_dma}`",
        f"Vivado {facts['design']['vivado_minimum']} or newer", f"clk/{KV260.linux_clock}/clk_enable_count",
    ):  # fmt: skip
        assert text in guide, text


def test_no_fact_is_written_down_again():
    """What people write by hand holds no address, part or pin: those come from the generated files."""
    written = [path for pattern in ("vivado/*.tcl", "sw/*.sh") for path in BOARD.glob(pattern)]
    written += [BOARD / name for name in ("platform.py", "Makefile", "bit2bin.py")]
    for path in {*written} - {BOARD / "vivado" / "facts.tcl"}:
        text = "\n".join(line.partition("#")[0] for line in path.read_text(encoding="utf-8").splitlines())
        text = re.sub(r'""".*?"""', "", text, flags=re.DOTALL)
        assert not re.search(r"0x[aA]00[0-9a-fA-F]{5}|xck26|kv260_som|\bA12\b|fan_en_b|pl_ps_irq0\[", text), path.name


@pytest.mark.parametrize("change, text", [
    (lambda f: f["control"]["dma"].update(address=0xA000_8000), "multiple of its size"),
    (lambda f: f["control"]["dma"].update(address=0xA000_0000), "overlap"),
    (lambda f: f["control"]["dma"].update(address=0xB000_0000), "outside of M_AXI_HPM0_FPD"),
    (lambda f: f["control"]["cmfpga"].update(size=0x8000), "control_address_width"),
    (lambda f: f["memory"].update(data_width=256), "must be 32, 64 or 128"),
    (lambda f: f["dma"].update(data_width=32), "nothing between them changes the width"),
    (lambda f: f["dma"].update(address_width=32), "does not reach"),
    (lambda f: f["linux"].update(buffer_events_size=1 << 26), "buffer_events_size"),
    (lambda f: f["clock"].update(mhz=250), "change both"),
])  # fmt: skip
def test_facts_that_contradict_each_other(change, text, maker, facts):
    changed = copy.deepcopy(facts)
    change(changed)
    with pytest.raises(maker.FactError, match=re.escape(text)):
        maker.check(changed)


def test_every_fact_has_a_source():
    """A line of ``board.toml``, or one near above it, names a file or a document, or says that the choice is ours."""
    lines = text_of("board.toml").splitlines()
    for section in tomllib.loads("\n".join(lines)):
        start = next(n for n, line in enumerate(lines) if line.startswith(f"[{section}]"))
        end = next((n for n in range(start + 1, len(lines)) if lines[n].startswith("[")), len(lines))
        comments = " ".join(line.partition("#")[2] for line in lines[start:end])
        assert re.search(r"ours|UG\d+|PG\d+|BoardStore|litex-boards|[\w-]+/[\w.-]+", comments), section


def test_no_path_of_a_machine():
    for path in BOARD.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and "build" not in path.relative_to(BOARD).parts:
            assert not re.search(r"/tmp/|/root/|/home/\w", path.read_text(encoding="utf-8")), path.relative_to(ROOT)
