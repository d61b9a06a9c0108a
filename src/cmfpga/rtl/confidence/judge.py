"""Judge: whether the contrast's peak is sharp enough for v to be trusted, as the probes come."""

from amaranth.hdl import Module
from amaranth.lib.wiring import In, Out

from .. import payloads
from .curvature import subtract
from .verdict import Deciding


class Judge(Deciding):
    """The comparison of :func:`cmfpga.protocol.confidence.is_trusted`, by shifting and adding: no multiplier.

    ΣI is squared while the probes are summed (:class:`~.verdict.Deciding`), and their gradients are added and
    subtracted as they come (:class:`~.curvature.Curvature`).

    ``done`` is high :attr:`latency` cycles after the gradient of the last probe, and ``doubtful`` right from then on.

    Parameters
    ----------
    config : Config

    Members
    -------
    new_batch : ``In(1)``
        Forget.
    begin : ``In(1)``
        As that of :class:`~.probe.Probe`.
    i : ``In``, flow of :func:`payloads.gradient`
        Of the four probes, in their order.
    sum_i : ``In``
        ΣI of the last iteration.
    squares : ``In``, :func:`payloads.squares`
        Of the last iteration.
    events, limit : ``In``
        n, and the setting ``confidence_limit``: R.
    curvature : ``Out``, :func:`payloads.curvature`
        Right from ``done`` on; 0 if nothing was probed since ``new_batch``.
    done, doubtful : ``Out(1)``
    """

    def __init__(self, config):
        super().__init__(
            config,
            {
                "new_batch": In(1),
                "i": In(payloads.flow(payloads.gradient(config))),
                "curvature": Out(payloads.curvature(config)),
            },
        )
        self.latency = self._steps

    def elaborate(self, platform):
        m = Module()
        self._decide(m, subtract(m, self, self.config.widths.g_zeros))
        with m.If(self.new_batch):
            m.d.sync += self.doubtful.eq(0)
        return m
