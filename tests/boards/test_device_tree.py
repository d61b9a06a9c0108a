"""The overlay compiles, merges onto a base like the board's, and says what the facts say."""

import subprocess

import pytest

from support.board_files import BOARD

#: The labels that the overlay refers to, and nothing else: as in the kernel's zynqmp.dtsi and the boards' trees.
BASE = """\
/dts-v1/;
/ {
	#address-cells = <2>;
	#size-cells = <2>;
	compatible = "xlnx,zynqmp";
	zynqmp_clk: clock-controller { #clock-cells = <1>; };
	zynqmp_reset: reset-controller { #reset-cells = <1>; };
	gic: interrupt-controller { #interrupt-cells = <3>; #address-cells = <0>; interrupt-controller; };
	fpga_full: fpga-region { compatible = "fpga-region"; #address-cells = <2>; #size-cells = <2>; ranges; };
	amba: axi { compatible = "simple-bus"; #address-cells = <2>; #size-cells = <2>; ranges; };
};
"""


def run(*words):
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture
def merged(tmp_path, tool):
    """The base with the overlay on it; the compiler warns of nothing that is ours."""
    dtc, fdtoverlay = tool("dtc", "device-tree-compiler"), tool("fdtoverlay", "device-tree-compiler")
    (tmp_path / "base.dts").write_text(BASE, encoding="utf-8")
    run(dtc, "-@", "-O", "dtb", "-o", tmp_path / "base.dtb", tmp_path / "base.dts")
    done = run(dtc, "-@", "-O", "dtb", "-o", tmp_path / "cmfpga.dtbo", BOARD / "sw" / "cmfpga.dtso")
    assert not done.stderr, done.stderr
    run(fdtoverlay, "-i", tmp_path / "base.dtb", "-o", tmp_path / "merged.dtb", tmp_path / "cmfpga.dtbo")
    return tmp_path / "merged.dtb"


@pytest.fixture
def get(merged, tool):
    fdtget = tool("fdtget", "device-tree-compiler")

    def read(node, name, kind="s"):
        values = run(fdtget, "-t", kind, merged, node, name).stdout.strip()
        return values if kind == "s" else [int(value, 16) for value in values.split()]

    return read


def phandle(get, node):
    return get(node, "phandle", "x")[0]


def test_bitstream(get, facts):
    assert get("/fpga-region", "firmware-name") == f"{facts['design']['name']}.bit.bin"
    assert get("/fpga-region", "resets", "x") == [phandle(get, "/reset-controller"), facts["clock"]["linux_reset"]]


def test_clock_has_a_user(get, facts):
    """Without it Linux turns the PL's clock off, and the first read of a register hangs."""
    clock = [phandle(get, "/clock-controller"), facts["clock"]["linux_clock"]]
    assert get("/axi/clocking0", "compatible") == "xlnx,fclk"
    assert get("/axi/clocking0", "clocks", "x") == clock == get("/axi/clocking0", "assigned-clocks", "x")
    assert get("/axi/clocking0", "assigned-clock-rates", "x") == [facts["clock"]["hertz"]]


def test_port_widths(get):
    """HP0 is 128 bits wide (0 in registers 4 and 5), HPM0 32 (0 in bits 9:8 of register 14)."""
    assert get("/axi/afi0", "compatible") == "xlnx,afi-fpga"
    assert get("/axi/afi0", "config-afi", "x") == [4, 0, 5, 0, 14, 0]


@pytest.mark.parametrize("block, name", [("cmfpga", "uio_cmfpga"), ("dma", "uio_dma")])
def test_uio(block, name, get, facts):
    where, node = facts["control"][block], facts["linux"][name]
    path = f"/axi/{node}@{where['address']:x}"
    assert get(path, "compatible") == "generic-uio"
    assert get(path, "linux,uio-name") == node
    assert get(path, "reg", "x") == [0, where["address"], 0, where["size"]]
    assert get(path, "clocks", "x") == [phandle(get, "/clock-controller"), facts["clock"]["linux_clock"]]
    if block == "cmfpga":
        assert get(path, "interrupts", "x") == [0, 89, 4]
        assert get(path, "interrupt-parent", "x") == [phandle(get, "/interrupt-controller")]


@pytest.mark.parametrize("which", ["events", "results"])
def test_buffers(which, get, facts):
    name = facts["linux"][f"buffer_{which}"]
    assert get(f"/axi/{name}", "compatible") == "ikwzm,u-dma-buf"
    assert get(f"/axi/{name}", "device-name") == name
    assert get(f"/axi/{name}", "size", "x") == [facts["linux"][f"buffer_{which}_size"]]
    assert get(f"/axi/{name}", "dma-mask", "x") == [facts["dma"]["address_width"]]


@pytest.mark.parametrize("bits, registers", [
    ((32, 128), {4: 0, 5: 0, 14: 0}), ((64, 64), {4: 1, 5: 1, 14: 0x100}), ((128, 32), {4: 2, 5: 2, 14: 0x200}),
])  # fmt: skip
def test_afi_registers_follow_the_widths(bits, registers, maker, facts):
    """As AMD's device-tree generator writes them: 0x500 is 64 bits for both HPM ports, 0xa00 128."""
    changed = {**facts, "control": {**facts["control"], "data_width": bits[0]},
               "memory": {**facts["memory"], "data_width": bits[1]}}  # fmt: skip
    assert dict(maker.afi(changed)) == registers
