"""Reports and files as Vivado lays them out, with figures that a test chooses. They are no figures of the design."""

import struct

#: What a run of the model finds, unless a test says otherwise.
FOUND = {
    "version": "2022.2",
    "boards": ["xilinx.com:kv260_som:part0:1.4"],
    "inline_slice": False,
    "synth_status": "synth_design Complete!",
    "impl_status": "write_bitstream Complete!",
    "wns": "0.120",
    "whs": "0.010",
    "wpws": "1.500",
    "unclocked": 0,
    "unsafe": False,
    "critical_cdc": False,
    "luts": 12345,
    "strange_layout": False,
}

ROW = "{:>12}{:>13}{:>23}{:>21}{:>13}{:>13}{:>23}{:>21}{:>13}{:>13}{:>24}{:>22}  "


def timing_summary(found):
    def total(slack):
        return f"{min(float(slack), 0.0) * 3:.3f}" if slack != "NA" else "NA"

    titles = (
        "WNS(ns)", "TNS(ns)", "TNS Failing Endpoints", "TNS Total Endpoints", "WHS(ns)", "THS(ns)",
        "THS Failing Endpoints", "THS Total Endpoints", "WPWS(ns)", "TPWS(ns)", "TPWS Failing Endpoints",
        "TPWS Total Endpoints",
    )  # fmt: skip
    values = []
    for key in ("wns", "whs", "wpws"):
        values += [found[key], total(found[key]), "0", "16519"]
    if found["strange_layout"]:
        titles = [title.replace("(ns)", "") for title in titles]
    met = all(found[key] != "NA" and float(found[key]) >= 0 for key in ("wns", "whs", "wpws"))
    return "\n".join([
        "check_timing report", "",
        f"1. checking no_clock ({found['unclocked']})", "-" * 24, "",
        "| Design Timing Summary", "| ---------------------", "-" * 40, "",
        ROW.format(*titles), ROW.format(*("-" * len(title) for title in titles)), ROW.format(*values), "", "",
        "All user specified timing constraints are met." if met else "Timing constraints are not met.", "",
    ])  # fmt: skip


def utilization(found):
    def row(name, used, available):
        return f"| {name:<26} | {used:>5} |     0 |          0 | {available:>9} | {100 * used / available:>5.2f} |"

    return "\n".join([
        "1. CLB Logic", "------------", "",
        "|          Site Type         |  Used | Fixed | Prohibited | Available | Util% |",
        row("CLB LUTs*", found["luts"], 117120), row("CLB Registers", 9876, 234240),
        row("Block RAM Tile", 10.5, 144), row("URAM", 0, 64), row("DSPs", 33, 1248), "",
    ])  # fmt: skip


def power(_):
    return "| Total On-Chip Power (W)  | 3.412        |\n| Dynamic (W)              | 2.9          |\n"


def clock_interaction(found):
    return "clk_a clk_b  Timed (unsafe)\n" if found["unsafe"] else "clk_pl_0  clk_pl_0  Clean  Timed\n"


def cdc(found):
    return "CDC-1  Critical  1-bit unknown CDC circuitry\n" if found["critical_cdc"] else "\n"


TEXTS = {
    "report_timing_summary": timing_summary,
    "report_utilization": utilization,
    "report_power": power,
    "report_clock_interaction": clock_interaction,
    "report_cdc": cdc,
    **{name: lambda _: "no text\n" for name in (
        "report_bus_skew", "report_methodology", "report_drc", "report_ram_utilization",
    )},
}  # fmt: skip


def bitstream(part, words=64, seed=1):
    """A .bit with a header like Vivado's, and data that are no configuration of anything."""
    data = b"\xff" * 64 + bytes.fromhex("aa995566") + b"".join(
        struct.pack(">I", (seed * 2654435761 + 40503 * n) & 0xFFFFFFFF) for n in range(words)
    )  # fmt: skip
    bit = bytes.fromhex("0009 0ff00ff00ff00ff000 0001")
    texts = (("a", "cmfpga_bd_wrapper;UserID=0XFFFFFFFF;Version=2022.2"), ("b", part), ("c", "2024/01/02"),
             ("d", "03:04:05"))  # fmt: skip
    for key, text in texts:
        bit += key.encode() + struct.pack(">H", len(text) + 1) + text.encode() + b"\0"
    return bit + b"e" + struct.pack(">I", len(data)) + data
