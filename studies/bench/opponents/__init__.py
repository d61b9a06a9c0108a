"""Programs for an ordinary computer that do what the core does, written to be hard to beat.

Each gets the events of a whole batch in memory and returns v, by the article's ascent (constant η) or by signs, with
dither, levels and schedule. The events vote into one image, and then each reads its four pixels back, because Σ I·D
over the pixels is the same sum taken over the events: in float32 (``gather.c``), and in integers of 16 bits
(``int16.c``), which is faster. The tests compare both with the float64 reference.
"""

from .c_program import CProgram, Job, Unavailable

__all__ = ["CProgram", "Job", "Unavailable", "make_programs"]


def make_programs():
    """``(programs, missing)``: those that run on this machine, and a line for each reason why others do not."""
    programs, missing = [], {}
    for form in ("gather", "int16"):
        try:
            programs.append(CProgram(form))
        except Unavailable as reason:
            missing[str(reason)] = None
    return programs, list(missing)
