"""The emitted core, broken on purpose: the test bench must find each of these."""

import re
from dataclasses import dataclass

from cmfpga.verilog.emit import TOP
from support.verilog_tools import modules


@dataclass(frozen=True)
class Mutant:
    """One change in the text of one module: the first, or ``every``, of ``occurrences`` of ``pattern`` is replaced."""

    name: str
    module: str
    pattern: str
    replacement: str
    occurrences: int = 1
    every: bool = False
    preset: str = "paper"  # whose core is broken
    says: str = ""  # a regular expression of what the bench prints

    def apply(self, text):
        """The broken text. Fails where the emitted text has changed so that the mutant means nothing any more."""
        before = modules(text)[f"{TOP}_{self.module}" if self.module else TOP]
        count = len(re.findall(self.pattern, before, re.DOTALL))
        assert count == self.occurrences, f"mutant {self.name!r} has to be rewritten: its pattern occurs {count} times"
        after = re.sub(self.pattern, self.replacement, before, count=0 if self.every else 1, flags=re.DOTALL)
        assert after != before and text.count(before) == 1
        return text.replace(before, after)

    def __str__(self):
        return self.name.replace(" ", "-")


def fast(*arguments, **options):
    return Mutant(*arguments, preset="fast", **options)


MUTANTS = [
    Mutant(
        "oldest sum wins", "image_accumulator_bank",
        r"if \(match_s5\) begin(\s+)base = total_s5;(.*?)if \(match_s3\) begin(\s+)base = total_s3;",
        r"if (match_s3) begin\1base = total_s3;\2if (match_s5) begin\3base = total_s5;",
        says="trace_sums",
    ),
    Mutant("second sum not forwarded", "image_accumulator_bank", r"if \(match_s4\)", "if (1'h0)"),
    Mutant("unsigned derivative", "image_accumulator_bank", r"\+ \$signed\((operation_s2\[\d+:\d+\])\)", r"+ \1", 2),
    # What a memory holds at power up stays: X here, anything in a device.
    Mutant("banks never cleared", "image_accumulator_bank", r"if \(operation_s2\[\d+\]\)", "if (1'h0)", says="x"),
    Mutant("batch begins before the banks are clear", "ingest_control", r"if \(cleared\)", "if (1'h1)", 2, every=True,
           says="cycles"),
    Mutant("ROI a row too high", "roi_filter", r"(\$signed\(y_s2\)) < ", r"\1 <= ", says="result_outside"),
    Mutant("reference time is the last event's", "roi_filter", r" & first;", ";", says="result_t_first"),
    Mutant("sign of a derivative", "voter", r"(= n\d+) \^ \{[^}]*\};", r"\1;", 8, says="trace_sums_d"),
    Mutant("corner beyond the ROI", "voter", r"(\$signed\(n\d+\)) < ", r"\1 <= ", 4),
    Mutant("rounded down", "ascent", r"(\$signed\(product_x_0_0_s1\)) \+ \$signed\(\d+'h\w+\)", r"\1", says="v_x"),
    Mutant("v wraps", "ascent_velocity", r"(= )n\d+ (\? \{ n)", r"\1 1'h0 \2", 2, every=True, says="v_x"),
    Mutant("sweep too short", "image_gradient_reader", r"(column == \d+'h)\w+", r"\g<1>0", says="words of pixels"),
    Mutant("one iteration too many", "iteration_control", r"(following == )handover__batch",
           r"\1 1'h1 + handover__batch", says="iteration"),
    Mutant("cycle not counted", "ingest_control", r"= 32'd1;", "= 32'd0;", says="result_cycles"),
    Mutant("result changes while it waits", "iteration_control", r"= cycles;", "= cycles + 1;",
           says="the waiting result"),
    Mutant("result is not waited for", "iteration_control", r"if \(taken\)", "if (1'h1)", says="result_valid"),
    Mutant("settings not kept", "ingest_control", r"(\[\d+:0\] <)= current;", r"\1= settings;"),
    Mutant("division is not waited for", "iteration_control", r"if \(divided\)(?= begin\s+\S+ <= 3'h4)", "if (1'h1)"),
    Mutant("batch never ends", "iteration_control", r"if \(run__updated\)(?= begin\s+if)", "if (1'h0)", 2, every=True,
           says="FAIL: time-out"),
    Mutant("overflow not counted", "event_buffer", r"= stored__overflow \+ 1'h1", "= stored__overflow",
           says="result_overflow"),
    Mutant("wrong pixel shown", "", r"pixels_3_dy = [^;]*", "pixels_3_dy = trace_pixels_3_dx", says="pixel"),
    fast("tag of another iteration counts", "image_tagged_accumulator_bank", r"(== tag_s2);", r"\1 | 1'h1;"),
    fast("tag stays", "image_tagged_accumulator", r"if \(next_tag\)", "if (1'h0)"),
    fast("schedule stands still", "ascent_schedule", r"= advance & (n\d)", r"= 1'h0 & \1"),
    fast("schedule not written", "ascent_schedule", r"if \(write__valid\)", "if (1'h0)", says="x"),
    fast("warm though nothing is followed", "ascent", r"(\[\d+\]) & tracking;", r"\1;", 2, every=True,
         says="iteration"),
    fast("a full buffer is not thinned out", "event_buffer", r"(assign stored__halved = )[^;]*", r"\1 1'h0",
         says="FAIL: time-out"),
    fast("dither stands still", "dither", r"= phase_x \+ [^;]*;", "= phase_x;", says="trace_sums"),
    fast("batch opened before the next ROI is known", "iteration_control", r"  handover__settled <= n[^;]*",
         "  handover__settled <= 1'h1", says="result_"),
]  # fmt: skip
