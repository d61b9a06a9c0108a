"""Programs for an ordinary computer that do what the core does, written to be hard to beat.

Who says that an accelerator is fast has to say: than what. Each program here gets the events of a whole batch in memory
and returns v, by the article's ascent (constant η) or by the sign ascent with dither, levels and schedule. It comes in
two forms:

literal
    The article's equations as they stand: zero three images, vote bilinearly into I, Dx and Dy, sweep them.
gather
    What a programmer who wants speed would do: vote into one image only, then have each event read its four
    pixels back, because Σ I·D over the pixels is the same sum taken over the events. (``gather.c`` has the details.)

The tests compare all of them with the float64 reference, at every v of an ascent.
"""

from .job import Job, Program, Unavailable

__all__ = ["Job", "Program", "Unavailable", "make_programs"]


def make_programs():
    """``(programs, missing)``: those that run on this machine, and a line for each that does not.

    Needs a C compiler, numba or torch for the respective ones, and none of them to be called.
    """
    from . import c_program, numba_program, torch_program

    programs, missing = [], []
    for module in (c_program, numba_program, torch_program):
        for make in module.MAKERS:
            try:
                programs.append(make())
            except Unavailable as reason:
                if str(reason) not in missing:
                    missing.append(str(reason))
    return programs, missing
