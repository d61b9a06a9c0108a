"""What tells how sure v is of motions beyond translation: velocities beside v, and how much the image loses there."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay, select


class Probe(Block):
    """Has events warped by v with one parameter after the other ¾ px nearer to 0; v itself stays.

    For motions beyond translation, whose iterations evaluate nothing but v.

    The first probe's velocity is there :attr:`latency` cycles after ``begin``, and each other as many after
    ``complete``, v itself after the last.

    Attributes
    ----------
    count : int
        Probes of a batch.

    Members
    -------
    new_batch : ``In(1)``
        Forget the sums.
    iterating : ``In(1)``
        An iteration is under way.
    begin : ``In(1)``
        v is the batch's result, and is to be probed. One cycle.
    complete : ``In(1)``
        The image has taken in an evaluation.
    v : ``In``, :func:`payloads.velocity`
    sums : ``In``, flow of :func:`payloads.sums`
    squares : ``In``, :func:`payloads.squares`
        With ``sums``.
    o : ``Out``, flow of :func:`payloads.velocity`
        By what to warp from now on.
    more : ``Out(1)``
        Another probe follows the one that is under way.
    last : ``Out``, :func:`payloads.sums`
        Of the last iteration.
    last_squares : ``Out``, :func:`payloads.squares`
    """

    latency = 3

    def __init__(self, config):
        self.count = len(config.motion_model.names)
        super().__init__(
            config,
            **dict.fromkeys(("new_batch", "iterating", "begin", "complete"), In(1)),
            v=In(payloads.velocity(config)),
            sums=In(payloads.flow(payloads.sums(config))),
            squares=In(payloads.squares(config)),
            o=Out(payloads.flow(payloads.velocity(config))),
            more=Out(1),
            last=Out(payloads.sums(config)),
            last_squares=Out(payloads.squares(config)),
        )

    def elaborate(self, platform):
        m = Module()
        distance = 3 << (self.config.v_frac - 2)
        turn = Signal(self.count)  # a bit for each parameter; none of them: v
        changes = self.begin | (self.complete & turn.any())
        with m.If(changes):
            m.d.sync += turn.eq(turn << 1 | self.begin)
        m.d.comb += [self.more.eq(turn[:-1].any()), self.o.valid.eq(delay(m, changes, 2, name="changes", valid=True))]
        for k, name in enumerate(self.config.motion_model.names):
            v = self.v[name]
            m.d.sync += self.o.payload[name].eq(v + Mux(turn[k], Mux(v[-1], distance, -distance), 0))
        with m.If(self.new_batch):
            m.d.sync += [self.last.eq(0), self.last_squares.eq(0)]
        with m.Elif(self.sums.valid & self.iterating):
            m.d.sync += [self.last.eq(self.sums.payload), self.last_squares.eq(self.squares)]
        return m


class LeastJudge(Block):
    """The comparison of :func:`cmfpga.protocol.confidence.is_sharp`, a bit of n and R a cycle: no multiplier.

    It finds the parameter along which the gradient falls the least as the probes come, one for each parameter; then it
    makes n·least − R·Σ I², with the factors that the fractions ask for.

    One batch at a time; ``done`` is high :attr:`latency` cycles after the gradient of the last probe, and ``doubtful``
    right from then on.

    Parameters
    ----------
    config : Config
        A motion with a basis.

    Members
    -------
    new_batch : ``In(1)``
        Forget.
    i : ``In``, flow of :func:`payloads.gradient`
        Of the probes, in the order of the parameters.
    v : ``In``, :func:`payloads.velocity`
        That is probed.
    last : ``In``, :func:`payloads.sums`
        Of the last iteration.
    squares : ``In``, :func:`payloads.squares`
        Of the last iteration.
    events, limit : ``In``
        n, and the setting ``confidence_limit``: R.
    curvature : ``Out``, :func:`payloads.curvature`
        Right from ``done`` on; 0 if nothing was probed since ``new_batch``.
    done, doubtful : ``Out(1)``
    """

    def __init__(self, config):
        self._factor_bits = max(bits_for(config.buffer_events), config.widths.limit_bits)
        self.latency = 4 + self._factor_bits  # subtract, compare, a bit of the factors each, add, say
        super().__init__(
            config,
            new_batch=In(1),
            i=In(payloads.flow(payloads.gradient(config))),
            v=In(payloads.velocity(config)),
            last=In(payloads.sums(config)),
            squares=In(payloads.squares(config)),
            events=In(bits_for(config.buffer_events)),
            limit=In(config.widths.limit_bits),
            curvature=Out(payloads.curvature(config)),
            done=Out(1),
            doubtful=Out(1),
        )

    def elaborate(self, platform):
        widths, names = self.config.widths, self.config.motion_model.names
        m = Module()
        least, came = self.curvature.least, Signal(range(len(names)))
        with m.If(self.new_batch):
            m.d.sync += came.eq(0)
        with m.Elif(self.i.valid):
            m.d.sync += came.eq(came + 1)
        # Stage 1: how far the gradient falls from the probe to v, or the other way round.
        probed = select(came, [self.i.payload[name] for name in names])
        last = select(came, [self.last[f"s{name}"] for name in names])
        above = select(came, [self.v[name][-1] for name in names])
        fall_s1 = delay(m, Mux(above, last - probed, probed - last), 1, name="fall")
        valid_s1 = delay(m, self.i.valid, 1, name="valid", valid=True)
        first_s1 = delay(m, came == 0, 1, name="first")
        last_s1 = delay(m, came == len(names) - 1, 1, name="last")
        # Stage 2: the least.
        with m.If(self.new_batch):
            m.d.sync += least.eq(0)
        with m.Elif(valid_s1 & (first_s1 | (fall_s1 < least))):
            m.d.sync += least.eq(fall_s1)
        begin = delay(m, valid_s1 & last_s1, 1, name="begin", valid=True)
        # A bit of each factor a cycle, the highest first, in two stages, so that three numbers are never added at once.
        factors = []
        for name, value in (("n", self.events), ("limit", self.limit)):
            factors.append(Signal(self._factor_bits, name=f"factor_{name}"))
            m.d.sync += factors[-1].eq(Mux(begin, value, factors[-1] << 1))
        by_n, by_limit = widths.judge_scales
        sides = [least * by_n, self.squares * by_limit]
        left, right = (Mux(factor[-1], side, 0) for factor, side in zip(factors, sides, strict=True))
        addend = delay(m, left - right, 1, name="addend")
        difference = Signal(signed(widths.judge_bits), reset_less=True)
        start = delay(m, begin, 1, name="start", valid=True)
        m.d.sync += difference.eq(Mux(start, 0, (difference << 1) + addend))
        m.d.comb += self.done.eq(delay(m, start, self._factor_bits + 1, name="bit", valid=True))
        with m.If(self.new_batch):
            m.d.sync += self.doubtful.eq(0)
        with m.Elif(self.done):
            m.d.sync += self.doubtful.eq(difference <= 0)
        return m
