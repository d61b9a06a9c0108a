"""``python -m studies.crosscheck``: random configurations and batches, the hardware against the integer model."""

import contextlib
import json
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cmfpga import cli

from .configs import assignments, kind_of, random_config

EXAMPLES = (
    "python -m studies.crosscheck",
    "python -m studies.crosscheck --seconds 36000 --seed 1000   # a night; Ctrl-C ends it sooner",
    "python -m studies.crosscheck --configs 1 --seed 1017       # one of them again",
    "python -m studies.crosscheck --configs 500 --json > crosscheck.json",
)


def _parser():
    made = cli.parser(
        "python -m studies.crosscheck",
        "Compare the emitted Verilog with the integer model, in every field of every result and every sum of every "
        "iteration, for random configurations and batches. Exit status 1 if they differ, or anything fails.",
        EXAMPLES,
    )
    length = made.add_mutually_exclusive_group()
    length.add_argument("--configs", type=cli.positive, metavar="N", help="so many configurations (default: 5)")
    length.add_argument("--seconds", type=cli.positive, metavar="S", help="begin none after S seconds")
    made.add_argument("--seed", type=cli.natural, default=0, metavar="K", help="configurations K, K+1, … (default: 0)")
    made.add_argument("--json", action="store_true", help="print the outcome as JSON")
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    from cmfpga.verilog.compiler import cannot_compile

    from .compare import check  # loads torch, or says what to install

    count = options.configs or (None if options.seconds else 5)
    begin = time.monotonic()
    totals, drawn, refused, findings, seed = np.zeros(2, int), np.zeros(2, int), 0, [], options.seed
    interruption = None
    try:
        with _own_cache() as cache, tqdm(total=count, unit="configuration", disable=None) as bar:
            while seed - options.seed < count if count else time.monotonic() - begin < options.seconds:
                kind = kind_of(seed)
                config, skipped = random_config(np.random.default_rng(seed), **kind)
                refused += skipped
                drawn += kind["regions"], kind["shell"]
                try:
                    totals += check(config, seed, kind["shell"])
                except Exception as error:
                    findings.append(_finding(seed, config, error))
                for made in cache.glob("cmfpga_*"):
                    made.unlink()
                bar.set_postfix(found=len(findings), refresh=False)
                bar.update()
                seed += 1
    except KeyboardInterrupt as error:  # after what was found until then
        interruption = error
    outcome = {
        "engine": "amaranth" if cannot_compile() else "verilator", "configurations": seed - options.seed,
        "with_regions": int(drawn[0]), "with_shell": int(drawn[1]), "refused": refused,
        "batches": int(totals[0]), "iterations": int(totals[1]),
        "mismatches": sum("traceback" not in finding for finding in findings),
        "tracebacks": sum("traceback" in finding for finding in findings),
        "seconds": round(time.monotonic() - begin, 1), "findings": findings,
    }  # fmt: skip
    print(json.dumps(outcome, indent=2, ensure_ascii=False) if options.json else _text(outcome))
    if interruption and not findings:
        raise interruption
    return 1 if findings else 0


def _finding(seed, config, error):
    from .compare import MismatchError

    finding = {"seed": seed, "what": f"{type(error).__name__}: {error}", "options": assignments(config)}
    finding["again"] = f"python -m studies.crosscheck --configs 1 --seed {seed}"
    if not isinstance(error, MismatchError):
        finding["traceback"] = "".join(traceback.format_exception(error))
    return finding


def _text(outcome):
    lines = []
    for finding in outcome["findings"]:
        lines += [finding.get("traceback", finding["what"]).rstrip()]
        lines += [f"  configuration: {finding['options']}", f"  again: {finding['again']}"]
    lines.append(
        "{configurations:,} configurations ({engine}; {with_regions:,} with regions, {with_shell:,} with the AXI top), "
        "{batches:,} batches, {iterations:,} iterations: {mismatches:,} "
        "mismatches, {tracebacks:,} tracebacks; {refused:,} refused; {seconds} s".format(**outcome)
    )
    return "\n".join(lines)


@contextlib.contextmanager
def _own_cache():
    """A folder for what is compiled, which goes with it: the user's cache is for what is used again."""
    from cmfpga.verilog.emit import environment

    with tempfile.TemporaryDirectory(prefix="cmfpga-crosscheck-") as folder, environment({"CMFPGA_CACHE": folder}):
        yield Path(folder)
