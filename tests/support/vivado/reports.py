"""What a run finds, unless a test says otherwise, and reports as Vivado lays them out. No figures of the design."""

FOUND = {
    "version": "2022.2", "boards": ["xilinx.com:kv260_som:part0:1.4"], "inline_slice": False,
    "synth_status": "synth_design Complete!", "impl_status": "write_bitstream Complete!", "wns": "0.120",
    "whs": "0.010", "wpws": "1.500", "unclocked": 0, "crossing": "Timed", "cdc": "Safe", "unit": "(ns)",
}  # fmt: skip

SLACKS = [("WNS", "TNS", "{wns}"), ("WHS", "THS", "{whs}"), ("WPWS", "TPWS", "{wpws}")]
ROWS = (
    [t for worst, total, _ in SLACKS for t in (f"{worst}{{unit}}", f"{total}{{unit}}", f"{total} Failing Endpoints",
                                               f"{total} Total Endpoints")],
    ["-------"] * 12, [t for *_, slack in SLACKS for t in (slack, "0.000", "0", "16519")],
)  # fmt: skip
RESOURCES = {"CLB LUTs*": 12345, "CLB Registers": 9876, "Block RAM Tile": 10.5, "URAM": 0, "DSPs": 33}
TEXTS = {
    "report_timing_summary": "1. checking no_clock ({unclocked})\n\n| Design Timing Summary\n-----------\n\n"
    + "".join("    " + "  ".join(row) + "  \n" for row in ROWS) + "\n\n",
    "report_utilization": "|          Site Type         |  Used | Fixed | Prohibited | Available | Util% |\n"
    + "".join(f"| {name:<26} | {n:>5} |     0 |          0 |    234240 |  1.00 |\n" for name, n in RESOURCES.items()),
    "report_power": "| Total On-Chip Power (W)  | 3.412        |\n| Dynamic (W)              | 2.9          |\n",
    "report_clock_interaction": "clk_pl_0  clk_pl_0  Clean  {crossing}\n",
    "report_cdc": "CDC-1  {cdc}  1-bit unknown CDC circuitry\n",
}  # fmt: skip
