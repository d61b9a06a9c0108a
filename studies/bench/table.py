"""The table of ``python -m studies.bench``, from the numbers that its ``--json`` writes."""

from cmfpga.config.presets import CLOCK_MHZ

from .cases import ARTICLE, KIM

ASCENTS = {
    "constant": "the article's ascent (constant η from v = 0)",
    "cold": "rounds, cold (dither, levels, schedule; from v = 0); programs: steps by signs",
    "warm": "rounds, warm (from the cold ones' v); programs: steps by signs",
}
HEADER = (
    "", "T", "cycles", "cycles/iter.", "last event → result", "whole batch", "back to back", "core: ×",
    "v, px/half batch",
)  # fmt: skip
#: (what, workload, ascent, field of the core's row, limit): what the presets must hold.
LIMITS = (
    ("cycles a round, n = 800, 64×64, preset quad", ARTICLE, "cold", "per_iteration", 856),
    ("cycles a round, n = 5000, 240×180, preset full-frame", KIM, "cold", "per_iteration", 5065),
    ("cycles, last event in → result out, n = 800, preset quad, judge=0, warm", ARTICLE, "warm", "after_last", 2650),
    ("cycles, whole batch, N = 5000, n = 800, preset quad, judge=0, cold", ARTICLE, "cold", "cycles", 9400),
    ("cycles from result to result, back to back, N = 5000, n = 800, preset quad, judge=0, warm", ARTICLE, "warm",
     "back_to_back", 5010),
)  # fmt: skip


def table(report):
    """``(lines of text, limits, speed-ups)`` of a report; the last two for its JSON."""
    clock = report["clock_mhz_assumed"]
    blocks = [(case, _rows(case, clock)) for case in report["cases"]]
    widths = [max(len(row[k]) for _, rows in blocks for row in (HEADER, *rows)) for k in range(len(HEADER))]
    lines = [
        f"Core: clock cycles counted in the simulated Verilog; times at an assumed {clock:g} MHz "
        f"({CLOCK_MHZ:g} MHz is what the",
        "article reports for its design; which clock this core reaches is not known).",
        f"Programs: one thread of this machine's processor, {report['processor']}; median of {report['runs']} runs",
        "(lowest–highest), events in its cache.",
        "core: × is how many times as fast as the program the first core above it, or with the confidence the second,",
        "is at that clock: for the whole batch, and from the last event on. Below 1 the program is faster.",
        "back to back: from result to result where events never pause; a program needs the whole batch's time.",
    ]
    for case, rows in blocks:
        size = f"N = {case['events']:,}, n = {case['roi_events']:,}, {case['width']}×{case['height']}"
        title = f"{case['workload']} ({size}): {ASCENTS[case['ascent']]}, T = {case['iterations']}"
        lines += ["", title, *(_line(row, widths) for row in (HEADER, *rows))]
    by_name = {(case["workload"], case["ascent"]): case for case in report["cases"]}
    limits, speed_ups = _limits(by_name), _speed_ups(by_name, clock, report["processor"])
    lines += ["", "Limits"]
    for limit in limits:
        verdict = "holds" if limit["holds"] else "FAILS"
        lines.append(f"  {limit['what']}: {limit['value']:,}; at most {limit['limit']:,}: {verdict}")
    if report["accuracy"]:
        lines += ["", "Accuracy (python -m studies.accuracy has more)"]
        lines += [f"  {what}" for what in report["accuracy"]["text"]]
    if speed_ups:
        lines += ["", f"Speed-ups of the core at an assumed {clock:g} MHz, whole batch ({speed_ups[0]['workload']})"]
        for name in dict.fromkeys(each["core"] for each in speed_ups):
            lines.append(f"  {name}:")
            of_it = [each for each in speed_ups if each["core"] == name]
            lines += [f"    {each['times']:8.2f} × as fast as {each['opponent']}" for each in of_it]
    lines += ["", "Programs"]
    lines += [f"  {name}: {how}" for name, how in report["programs"].items()]
    if report["foreign"]:
        lines += ["", f"Foreign programs ({ARTICLE}, from v = 0, by their own search, on all their threads)"]
        for row in report["foreign"]:
            lines.append(f"  {row['how']}: {_times(row['batch'])}; v, px/half batch: {_v(row['v'])}")
    if report["missing"]:
        lines += ["", "Not measured", *(f"  {line}" for line in report["missing"])]
    return lines, limits, speed_ups


def _line(row, widths):
    cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
    return "  " + "  ".join(cells).rstrip()


def _rows(case, clock):
    def cycles_of(count):
        return "" if count is None else f"{count:,} cycles  {_time(count / clock * 1e-6)}"

    rows, cores = [], [*case["cores"]]
    if case["ascent"] == "constant":
        after = case["article_cycles"] - case["events"]
        cores.append({
            "name": "the article's formula", "measured": True, "cycles": case["article_cycles"], "after_last": after,
            "per_iteration": after // case["iterations"], "back_to_back": None, "v": None,
        })  # fmt: skip
    for core in cores:
        cycles = f"{core['cycles']:,}" + ("" if core["measured"] else " computed")
        rows.append((
            core["name"], str(case["iterations"]), cycles, f"{core['per_iteration']:,}", cycles_of(core["after_last"]),
            _time(core["cycles"] / clock * 1e-6), cycles_of(core["back_to_back"]), "", _v(core["v"]),
        ))  # fmt: skip
    for program in case["programs"]:
        core = case["cores"][program["confidence"]]  # the second core computes it
        pairs = (("batch", "cycles"), ("ascent", "after_last"))
        ratios = (program[what]["median"] / (core[cycles] / clock * 1e-6) for what, cycles in pairs)
        rows.append((
            program["name"], str(case["steps"]), "", "", _times(program["ascent"]), _times(program["batch"]), "",
            " ".join(f"{ratio:.2f}" for ratio in ratios), _v(program["v"]),
        ))  # fmt: skip
    return rows


def _v(v):
    return "" if v is None else f"{v[0]:.3f} {v[1]:.3f}"


def _time(seconds):
    return f"{seconds * 1e6:,.1f} µs" if seconds < 1e-3 else f"{seconds * 1e3:,.3f} ms"


def _times(times):
    scale, unit, digits = (1e6, "µs", 1) if times["median"] < 1e-3 else (1e3, "ms", 3)
    median, low, high = (f"{times[key] * scale:,.{digits}f}" for key in ("median", "low", "high"))
    return f"{median} {unit} ({low}–{high})"


def _limits(cases):
    found = []
    for what, workload, ascent, value, limit in LIMITS:
        case = cases.get((workload, ascent))
        if case and (number := case["cores"][0][value]) is not None:
            found.append({"what": what, "value": number, "limit": limit, "holds": number <= limit})
    return found


def _speed_ups(cases, clock, processor):
    """The preset ``quad`` against everything, each opponent named."""
    article = cases[ARTICLE, "constant"]["article_cycles"] / clock * 1e-6
    found = []
    for ours in ("cold", "warm"):
        for confidence, core in enumerate(cases[ARTICLE, ours]["cores"][:2]):
            opponents = [(f"the article's formula, T = 100, at {clock:g} MHz too", article)]
            for theirs, what in (("constant", "the article's ascent"), (ours, "steps by signs")):
                case = cases[ARTICLE, theirs]
                for program in case["programs"]:
                    if theirs == "constant" or program["confidence"] == confidence:
                        named = f"{program['name']}, {what}, T = {case['steps']}, on this CPU ({processor})"
                        opponents.append((named, program["batch"]["median"]))
            about = {"workload": ARTICLE, "core": f"{core['name']}, {ours}, T = {core['iterations']}"}
            seconds = core["cycles"] / clock * 1e-6
            found += [{**about, "opponent": opponent, "times": taken / seconds} for opponent, taken in opponents]
    return found
