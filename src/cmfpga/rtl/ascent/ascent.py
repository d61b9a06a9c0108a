"""The seam behind the gradient: whatever moves v, and says how often."""

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from ...protocol.settings import PLANS
from .. import Block, payloads
from ..arithmetic import delay
from .velocity import Velocity


def ascent_run(config):
    """Signature of a batch's run, from iteration control to the ascent.

    Members
    -------
    settings
        :func:`payloads.settings` of the batch, from the cycle after ``take``.
    take
        A batch begins; ``planned`` is right in all cycles after the next.
    start
        Its iterations begin, at least four cycles after ``take``.
    done, degenerate
        While the result waits; whether the batch measured nothing.
    planned
        Iterations of the batch.
    updated
        v has changed.
    plan
        Which of :data:`~cmfpga.protocol.settings.PLANS` its iterations follow. Only where windows slide.
    final, doubtful
        The iteration is the batch's last; with ``done``, whether v is in doubt. Only where that is measured.
    """
    signals = ("take", "start", "done", "degenerate", *(("final", "doubtful") if config.confidence else ()))
    return wiring.Signature(
        {
            "settings": Out(payloads.settings(config)),
            **dict.fromkeys(signals, Out(1)),
            **({"plan": Out(range(len(PLANS)))} if config.slides else {}),
            "planned": In(config.widths.iteration_bits),
            "updated": In(1),
        }
    )


class Ascent(Block):
    """A way to move v. Each is a subclass, listed in :data:`cmfpga.rtl.ascent.ASCENTS`.

    Parameters
    ----------
    target_bits : int or None
        Width of what v would be if it were not limited; None where it has been.
    members : dict
        Of its own, beside those of the signature.

    Members
    -------
    i : ``In``, flow of :func:`payloads.gradient`
        The gradient.
    run : ``In``, :func:`ascent_run`
    v : ``Out``, :func:`payloads.velocity`
        Zero after a reset. It has changed, and ``run.updated`` is high, :attr:`latency` cycles after a gradient enters.
    level : ``Out``
        Pixels of this iteration are 2^level px wide; changes with v.
    restarted : ``Out(1)``
        The batch began cold, because the one before was doubtful. Only where v's confidence is measured.
    probe, warped
        As the :class:`~.velocity.Velocity` has them. Only where v's confidence is measured, and not by rounds.
    saturated : ``Out(1)``
        A number was limited to its format since ``run.take``.
    limited : ``Out(1)``
        An entry of a schedule that was used since ``run.take`` was out of range.

    Attributes
    ----------
    latency : int
        Cycles from a gradient to ``run.updated``.
    blocks : dict
        The parts by name, in the order of data flow.
    """

    def __init__(self, config, *, target_bits, members=None):
        layout, self._probes = payloads.velocity(config), config.confidence and config.ascent_rule.evaluations == 1
        probed = {"probe": In(payloads.flow(layout)), "warped": Out(layout)} if self._probes else {}
        probed |= {"restarted": Out(1)} if config.confidence else {}
        self.velocity = Velocity(layout, target_bits=target_bits, probes=bool(self._probes), holds=config.slides)
        super().__init__(
            config,
            i=In(payloads.flow(payloads.gradient(config))),
            run=In(ascent_run(config)),
            v=Out(payloads.velocity(config)),
            level=Out(bits_for(config.max_level)),
            saturated=Out(1),
            limited=Out(1),
            **probed,
            **(members or {}),
        )

    @property
    def blocks(self):
        return {"ascent": self}

    def begin(self, warm):
        """A module with the velocity in it, which begins with the batch's start unless it is ``warm``."""
        m = Module()
        m.submodules.velocity = velocity = self.velocity
        take = self.run.take
        if self.config.slides:  # where it comes from far away
            take = delay(m, take, 1, name="take", valid=True)
        m.d.comb += [
            velocity.new_batch.eq(take),
            velocity.load.eq(self.run.start & ~warm),
            velocity.start.eq(self.run.settings.v_start),
            self.v.eq(velocity.v),
            self.saturated.eq(velocity.saturated),
            self.run.updated.eq(velocity.moved),
        ]
        if self._probes:
            m.d.comb += [velocity.probe.valid.eq(self.probe.valid), velocity.probe.payload.eq(self.probe.payload)]
            m.d.comb += self.warped.eq(velocity.warped)
        return m
