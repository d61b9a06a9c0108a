"""Evaluators: an event's votes at the four velocities beside a centre."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect

from ...config.schedule import DISTANCES
from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay, select
from .voter import BilinearVoter
from .warp import of_level, start_of


class Evaluators(Block):
    """Warps each event by c − h·e_x, c + h·e_x, c − h·e_y and c + h·e_y, and votes for each; no format limits these.

    Both products dt·c are made once. The four positions differ from x − dt·c by 0 or ±dt·h, and h is one of five
    distances: an adder makes 3·dt, and another one each position. All else is as in the
    :class:`~cmfpga.rtl.image.warp.Warp` and the voter, with a cycle more::

        stage   1                2               3              4, 5             voter
                dt·c, 3·dt ────► x − dt·c ─────► ± dt·h ──────► level, clamp ──► votes
                                 dt·h ──────────►

    With four ``evaluators`` there are four voters, and an event in every cycle. With one, an event stays for four
    cycles, in which the four evaluations go through the same adders and one voter; it comes in the first of them. A
    cycle more chooses between them.

    Latency :attr:`latency` cycles. ``centre`` is used in the cycle in which an event enters, ``distance`` in the next
    one, and ``level`` from the third on, or the fourth.

    Parameters
    ----------
    config : Config
        Of an ascent of four evaluations.
    event : StructLayout, optional
        Of a window that slides: ``dt``, ``x``, ``y`` and ``last``; its events lie in and around the image.

    Members
    -------
    i : ``In``, flow of :func:`payloads.scaled_event`, or of ``event``
    centre : ``In``, :func:`payloads.velocity`
    distance : ``In``, :func:`payloads.distance`
    level : ``In``
        Centre, distance and level change only while no event is in flight.
    o : ``Out``, array of flows of :func:`payloads.votes`
        For each evaluator. One evaluator's addresses have two bits more, the lowest, which differ between the
        evaluations of an event; and ``last`` marks the last evaluation of the last event.
    """

    def __init__(self, config, event=None):
        self.voters = [BilinearVoter(config) for _ in range(config.evaluators)]
        self._moving = (5 if config.max_level else 4) + (config.evaluators == 1)
        self.latency = self._moving + BilinearVoter.latency
        super().__init__(
            config,
            i=In(payloads.flow(event or payloads.scaled_event(config))),
            centre=In(payloads.velocity(config)),
            distance=In(payloads.distance(config)),
            level=In(bits_for(config.max_level)),
            o=Out(payloads.flow(payloads.votes(config))).array(config.evaluators),
        )

    def elaborate(self, platform):
        config, event = self.config, self.i.payload
        m = Module()
        for number, voter in enumerate(self.voters):
            m.submodules[f"voter_{number}"] = voter
        level = delay(m, self.level, 1, name="level")
        voted_level = delay(m, level, 1, name="voted_level")  # of its own, for wires are long
        # Stage 1: multiply. It stays until the next event comes.
        dt_s1 = Signal.like(event.dt, name="dt_s1", reset_less=True)
        three_s1 = Signal(signed(len(event.dt) + 2), reset_less=True)
        with m.If(self.i.valid):
            m.d.sync += [dt_s1.eq(event.dt), three_s1.eq((event.dt << 1) + event.dt)]
        # Stage 2: how far beside the centre an event lies. Both axes: x − dt·c.
        beside = select(self.distance, [self._times_dt(each, dt_s1, three_s1) for each in DISTANCES])
        centres = {axis: self._centre(m, axis) for axis in ("x", "y")}
        valid_s1, last_s1, number_s1 = self._begin(m)
        if config.evaluators == 1:
            places = [self._in_turn(m, centres, beside, number_s1)]
        else:
            places = self._side_by_side(m, centres, beside)
        # Stages 4, 5: pixels of the level, clamped.
        dt, last = (delay(m, value, self._moving - 1, name=name) for name, value in (("dt", dt_s1), ("last", last_s1)))
        valid = delay(m, valid_s1, self._moving - 1, name="valid", valid=True)
        placed = {}  # those that several voters have are made once
        for voter, place in zip(self.voters, places, strict=True):
            warped = voter.i.payload
            for axis, (name, position) in place.items():
                if name not in placed:
                    placed[name] = Signal(warped[axis].shape(), name=name, reset_less=True)
                    m.d.sync += placed[name].eq(of_level(m, config, position, axis, level, name=name))
                m.d.comb += warped[axis].eq(placed[name])
            m.d.comb += [voter.i.valid.eq(valid), warped.dt.eq(dt), warped.last.eq(last), voter.level.eq(voted_level)]
        for voter, o in zip(self.voters, self.o, strict=True):
            connect(m, voter.o, wiring.flipped(o))
        if config.evaluators == 1:
            # Whichever turn that is: evaluations of one turn have one number, and others have others.
            for bank, vote in zip(self.o[0].payload.banks, self.voters[0].o.payload.banks, strict=True):
                m.d.comb += bank.address.eq(Cat(number_s1, vote.address))
        return m

    def _times_dt(self, quarters, dt, three):
        """``quarters``·dt, of a number 2^k or 3·2^k."""
        return three << (quarters // 3).bit_length() - 1 if quarters % 3 == 0 else dt << quarters.bit_length() - 1

    def _centre(self, m, axis):
        """x − dt·c: multiplied in stage 1, subtracted in stage 2."""
        config, event, c = self.config, self.i.payload, self.centre[axis]
        start, width = start_of(config, event[axis])
        full = signed(max(width, len(event.dt) + len(c)) + 2)
        product_s1 = Signal(signed(len(event.dt) + len(c)), reset_less=True, name=f"product_{axis}_s1")
        start_s1 = Signal(full, reset_less=True, name=f"start_{axis}_s1")
        with m.If(self.i.valid):
            m.d.sync += [product_s1.eq(event.dt * c), start_s1.eq(start)]
        inverse_s2 = Signal(full, reset_less=True, name=f"inverse_{axis}_s2")
        m.d.sync += inverse_s2.eq(~start_s1 + product_s1)  # a − b = ~(~a + b), as in the warp
        return ~inverse_s2

    def _begin(self, m):
        """Whether there is an event in stage 1, whether it is the last, and which evaluation's turn it is."""
        if self.config.evaluators > 1:
            return (
                delay(m, self.i.valid, 1, name="begin", valid=True),
                delay(m, self.i.payload.last, 1, name="last"),
                None,
            )
        left = Signal(4)  # a bit for each turn that is left
        last, number = Signal(), Signal(2)
        m.d.sync += [left.eq(Mux(self.i.valid, 0b1111, left >> 1)), number.eq(Mux(self.i.valid, 0, number + 1))]
        with m.If(self.i.valid):
            m.d.sync += last.eq(self.i.payload.last)
        return left[0], last & ~left[1], number

    def _beside(self, m, value, name):
        """``value``, in stage 2."""
        return delay(m, value << self.config.v_frac - 2, 1, name=name)

    def _in_turn(self, m, centres, beside, number):
        """Stages 3, 4 of one evaluator: ``{axis: (name, position)}`` of the evaluation whose turn it is."""
        beside_s2, below, along_y = self._beside(m, beside, "beside"), *delay(m, number, 1, name="turn")
        signed_s2 = Mux(below, -beside_s2, beside_s2)
        places = {}
        for axis, own in (("x", ~along_y), ("y", along_y)):
            signed_s3 = delay(m, signed_s2, 1, name=f"beside_{axis}")
            with m.If(~own):  # a reset, which takes no LUT
                m.d.sync += signed_s3.eq(0)
            centre_s3 = delay(m, centres[axis], 1, name=f"centre_{axis}")
            places[axis] = axis, delay(m, centre_s3 + signed_s3, 1, name=f"place_{axis}")
        return places

    def _side_by_side(self, m, centres, beside):
        """Stage 3 of four: the same of each."""
        beside_s2, there = self._beside(m, beside, "beside"), {}
        for axis, centre in centres.items():
            sums = {"": centre, "_below": centre + beside_s2, "_above": centre - beside_s2}
            there[axis] = {
                what: (f"{axis}{what}", delay(m, value, 1, name=f"place_{axis}{what}")) for what, value in sums.items()
            }
        ways = ("_below", ""), ("_above", ""), ("", "_below"), ("", "_above")
        return [{"x": there["x"][x], "y": there["y"][y]} for x, y in ways]
