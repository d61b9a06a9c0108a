"""Settings: what software wrote, limited to what is allowed, and handed over batch by batch."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from . import payloads
from .register_bank import layout_of, member


class Settings(wiring.Component):
    """The settings of the next batch.

    They may change in every cycle until a batch is opened; what stands here in the cycle of ``opened`` are its
    settings. While ``lock`` is high they are those of the last batch that was opened, less ``ROI_LOAD``.

    Parameters
    ----------
    config : Config
    registers : RegisterMap

    Members
    -------
    written : ``In``
        Stored fields and flags, as the register bank's ``values`` has them.
    lock : ``In(1)``
    opened : ``In(1)``
    o : ``Out``, :func:`payloads.settings`
    limited : ``Out(1)``
        A value of ``o`` had to be limited.
    out_of_range : ``Out(1)``
        A value of ``written`` has to be.
    used_roi : ``Out(1)``
        One cycle: the ROI was loaded.
    """

    def __init__(self, config, registers):
        self.config = config
        self.registers = registers
        super().__init__(
            {
                "written": In(layout_of(registers, "stored", "flag", "sticky")),
                "lock": In(1),
                "opened": In(1),
                "o": Out(payloads.settings(config)),
                "limited": Out(1),
                "out_of_range": Out(1),
                "used_roi": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        asked = Signal(payloads.settings(self.config))
        wrong = []
        for link, parts in self.registers.linked("Settings").items():
            ((register, f),) = parts
            value = self.written[member(register, f)]
            low, high = f.low, f.high
            targets = self._targets(asked, link)
            fits = targets[0].shape()
            if high is None and not fits.signed and fits.width < f.width:
                high = (1 << fits.width) - 1  # not allowed to alias; the core limits and flags it
                wrong.append(value > high)
                value = Mux(value > high, high, value)
            elif high is not None:
                lowest, highest = f.range
                if high < highest:
                    wrong.append(value > high)
                    value = Mux(value > high, high, value)
                if low is not None and low > lowest:
                    wrong.append(self.written[member(register, f)] < low)
                    value = Mux(wrong[-1], low, value)
            for target in targets:
                m.d.comb += target.eq(value)
        used = Signal(payloads.settings(self.config))
        used_limited = Signal()
        m.d.comb += [
            self.out_of_range.eq(sum(wrong, 0) != 0) if wrong else self.out_of_range.eq(0),
            self.o.eq(Mux(self.lock, used, asked)),
            self.limited.eq(Mux(self.lock, used_limited, self.out_of_range)),
            self.used_roi.eq(self.opened & ~self.lock),
        ]
        with m.If(self.opened):
            m.d.sync += [used.eq(self.o), used.core.roi_load.eq(0), used_limited.eq(self.limited)]
        return m

    def _targets(self, asked, link):
        """Where a setting goes: the core's settings (``v_start_x`` is ``v_start.x``), the batch end's, or both."""
        found = []
        for part in (asked.core, asked.end):
            members = part.shape().members
            if link in members:
                found.append(part[link])
                continue
            outer, _, inner = link.rpartition("_")
            if outer in members:
                found.append(part[outer][inner])
        assert found, link
        return found
