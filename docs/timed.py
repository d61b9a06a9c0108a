"""Tables of what a batch takes: cycles by the formula of each preset, and times at the clock that was measured last."""

from amaranth.hdl import Fragment
from declared import RESOURCES, table

from cmfpga.config import PRESETS, preset
from cmfpga.fpga.families import ECP5, FAMILIES
from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.sliding.core import SlidingCore
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog import description

#: What is estimated of a core, by the name of its column.
ESTIMATED = {"lut": "LUT", "ff": "FF", "bram36": "BRAM36", "uram": "UltraRAM", "dsp": "DSP"}


def _estimated(row):
    return (f"{row[kind]:,}" for kind in ESTIMATED)


def elaborated(config):
    """A core that has been elaborated once (Amaranth warns of those that never are)."""
    core = VerilogCore(config)
    Fragment.get(core, None)
    return core


def article_cycles(core, **options):
    """Pairs (T, cycles) of the article's batch, by default: of an ascent by signs without a last v, and with one."""
    config = core.config
    if hasattr(core, "schedule_write"):
        schedules = (config.schedules.cold, config.schedules.warm)
    else:
        schedules = (config.ascent_rule.plan(BatchSettings.from_config(config), warm=False),)
    return [(len(one), core.cycles(**description.ARTICLE_BATCH, iterations=one, **options)) for one in schedules]


def placed_table():
    """Clock and area that were measured last, and what the clock makes of the article's batch."""
    stored, rows = RESOURCES["placed"], []
    for name, row in stored.items():
        if preset(name).slides:
            core = SlidingCore(preset(name))
            Fragment.get(core, None)
            after = core.tail + core.hop_control.latency - 1  # from the event that ends a hop
            waits = [f"{after / row['fmax_mhz']:.2f} (a hop)"]
        else:
            waits = [
                f"{(cycles - description.ARTICLE_BATCH['events']) / row['fmax_mhz']:.1f} (T = {count})"
                for count, cycles in article_cycles(elaborated(preset(name)), judge=0)
            ]
        seeds, area = ", ".join(map(str, row["seeds"])), (f"{row[kind]:,}" for kind in ECP5.resources)
        rows.append((f"`{name}`", row["fmax_mhz"], seeds, " / ".join(waits), *area))
    titles = (title for _, title in ECP5.resources.values())
    head = ("preset", "MHz, median", "seeds 1, 2 …", "last event → result, µs", *titles)
    how = next(iter(stored.values()))
    made = table(head, rows, right=(1, *range(3, len(head))))
    return f"{made}\n{how['device']}, speed {how['speed']}; Yosys {how['yosys']}, nextpnr {how['nextpnr']}.\n"


def families_table():
    """The same of other families: resources by their own names."""
    rows = []
    for name, row in RESOURCES["families"].items():
        family = FAMILIES[row["device"]]
        used = ", ".join(f"{row[kind]:,} {title}" for kind, (_, title) in family.resources.items())
        mhz = f"(≤ {row['fmax_mhz']})" if family.untimed else row["fmax_mhz"]
        device = f"{family.title} {row['device']}, speed {row['speed']}"
        rows.append((device, f"`{name.split(',')[0]}`", mhz, ", ".join(map(str, row["seeds"])), used))
    return table(("device", "preset", "MHz, median", "seeds 1, 2 …", "resources"), rows, right=(2,))


def cycles_table():
    """Formula of each preset of one ROI, beside the article's."""
    rows = []
    for name, config in PRESETS.items():
        if config.regions or config.slides:
            continue
        core = elaborated(config)
        shown = " / ".join(f"{cycles:,} (T = {count})" for count, cycles in article_cycles(core))
        theirs = description.article_cycles(**description.ARTICLE_BATCH, pixels=config.geometry.pixels, iterations=100)
        size = f"{config.roi_width}×{config.roi_height}"
        rows.append((f"`{name}`", size, f"`{core.cycle_formula}`", shown, f"{theirs:,}"))
    sizes = "N = {events}, n = {roi_events}".format(**description.ARTICLE_BATCH)
    head = ("preset", "ROI, px", "cycles of a batch", sizes, "article's formula, T = 100")
    return table(head, rows, right=(3, 4))


def motions_table():
    """Resources of the motions' cores, beside those of a translation in the same ROI."""
    rows = []
    for name, row in RESOURCES["motions"].items():
        config = preset(name)
        size = f"{config.roi_width}×{config.roi_height} px, {config.buffer_events:,} events"
        rows.append((f"`{name}`", config.motion, size, *_estimated(row)))
    heads = ("preset", "motion", "ROI, buffer", *ESTIMATED.values())
    return f"{table(heads, rows, right=(3, 4, 5, 6, 7))}\nEstimates by Yosys, of the core alone.\n"


def regions_table():
    """Resources of hardware of many regions, and of one of its units."""
    what = {"flow, a unit": "a unit by itself", "flow, one unit": "`flow` with one unit", "flow": "`flow`: five units"}
    rows = [(what[name], *_estimated(row)) for name, row in RESOURCES["regions"].items()]
    return f"{table(('', *ESTIMATED.values()), rows, right=(1, 2, 3, 4, 5))}\nEstimates by Yosys, without AXI.\n"


TIMED = {
    "regions": regions_table, "motions": motions_table, "cycles": cycles_table, "placed": placed_table,
    "families": families_table,
}  # fmt: skip
