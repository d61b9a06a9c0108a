"""The iterating half of a core: everything from the event buffer to the verdict."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import connect, flipped

from ..config.schedule import ScheduleEntry, used_events
from ..protocol.settings import by_signs
from .arithmetic import delay
from .ascent import ASCENTS
from .ascent.gradient import Gradient
from .confidence.probe import LeastJudge, Probe
from .confidence.verdict import Means, Verdict
from .image import image_of
from .image.event_path import EventPath
from .ingest.event_buffer import EventBuffer
from .iteration_control import IterationControl
from .sliding.ring import Ring


def boxes_of(core, *parts):
    """``{name: block}`` of attributes by their names, and of dictionaries of blocks; without those that are None."""
    named = [part if isinstance(part, dict) else {part: getattr(core, part)} for part in parts]
    return {name: block for part in named for name, block in part.items() if block is not None}


class Iterating:
    """What :class:`~cmfpga.rtl.core.Core` and a unit of :class:`~cmfpga.rtl.regions.regions.Regions` share.

    A component that inherits it makes the blocks, puts them into its module, and connects them; it fills the event
    buffer, hands batches over to ``iteration_control``, and offers the results.
    """

    def _make_iterating(self, *, move=1, settle=1, verdict=True):
        """The blocks; ``move`` and ``settle`` are the cycles of an ROI's update.

        Without a ``verdict`` it is decided elsewhere whether a translation is in doubt.
        """
        config = self.config
        self.rounds = config.ascent_rule.evaluations > 1
        self.event_buffer = (Ring if config.slides else EventBuffer)(config)
        self.path = EventPath(config)
        in_flight = self.event_buffer.latency + self.path.latency - 1
        self.image = image_of(config)(config, in_flight=in_flight)
        self.gradient = Gradient(config, lead=self.image.lead)
        self.ascent = ASCENTS[config.ascent](config)
        self.means = Means(config) if self.rounds else None
        self.probe = Probe(config) if config.confidence and not self.rounds else None
        judge = (Verdict if verdict else None) if self.rounds else LeastJudge
        self.judge = judge(config) if config.confidence and judge else None
        # From a replay to the warp; from the last vote to the next v.
        self._feed = in_flight + 1 - self.path.evaluating
        self._evaluate = self.image.latency + self.gradient.latency + self.ascent.latency
        self._replay_delay = max(0, self._evaluate - self._feed)
        self.iteration_control = self._make_control(move, settle)

    def _make_control(self, move, settle):
        delays = {"replay_delay": self._replay_delay, "probe_delay": Probe.latency}
        return IterationControl(self.config, move=move, settle=settle, **delays)

    @property
    def blocks(self):
        """The boxes, but in place of image and ascent what they are made of."""
        boxes = [getattr(block, "blocks", {name: block}) for name, block in self.boxes.items()]
        return {name: block for box in boxes for name, block in box.items()}

    @property
    def latencies(self):
        """Clock cycles from input to output of each block that the events or the sums go through, by name."""
        return {name: block.latency for name, block in self.blocks.items() if hasattr(block, "latency")}

    @property
    def iteration_latency(self):
        """L: an iteration of n events takes n + L cycles from one v to the next, and those of the image's sweep.

        The sweep's first address follows the last vote by one cycle; what is evaluated is its last address, or
        in one pass the last vote.
        """
        return self.path.evaluating - 1 + max(self._evaluate, self._feed)

    @property
    def sweep_cycles(self):
        """Cycles of an iteration between its last vote and the image being complete: P/4 with the sweep."""
        return self.image.sweep_cycles

    @property
    def judge_latency(self):
        """Cycles that a batch takes more if v's confidence is measured, beside those of iterations."""
        if self.rounds:  # the verdict begins with the last sums, the ascent with the last gradients
            return max(1, self.judge.latency + 1 - self.gradient.latency - self.ascent.latency) if self.judge else 1
        return self.probe.latency + self.judge.latency - self.ascent.latency

    def iterated_cycles(self, roi_events, iterations, judge=None):
        """Clock cycles of a batch's iterations and probes; parameters as those of :meth:`.core.Core.cycles`."""
        judged = self.config.confidence and (self.config.judge if judge is None else judge)
        every = ScheduleEntry(0, None)
        plan = (every,) * iterations if isinstance(iterations, int) else tuple(iterations)
        probes = [every] * self.probe.count if self.probe and judged else []
        plan, more = (*plan, *probes), self.judge_latency if judged else 0
        votes = sum(used_events(plan, roi_events)) << self.config.geometry.turn_bits
        return votes + len(plan) * (self.sweep_cycles + self.iteration_latency) + more

    def iterated_formula(self, beside):
        """:meth:`iterated_cycles` as text, and ``beside`` cycles more."""
        each = " + ".join(str(cycles) for cycles in (self.sweep_cycles, self.iteration_latency) if cycles)
        if not by_signs(self.config):  # no schedule says which events are used
            return f"T·(n + {each}) + {beside}"
        each = f"({each})" if self.sweep_cycles else each
        if self.rounds:
            events = "4·n" if self.config.geometry.turn_bits else "n"
            judged = self.judge_latency if self.config.confidence else 0
            return f"T·({events} + {self.iteration_latency}) + {beside + judged}"
        if self.judge is None:
            return f"Σ n_k + T·{each} + {beside}"
        probes = self.probe.count
        return f"Σ n_k + {probes}·n + (T + {probes})·{each} + {beside + self.judge_latency}"

    def _with_boxes(self):
        """A module with the boxes in it."""
        m = Module()
        for name, block in self.boxes.items():
            m.submodules[name] = block
        return m

    def _iterate(self, m, batch, reciprocal):
        """Replay while there is room, scale, warp, vote, sum; ``batch`` and ``reciprocal`` say how times are scaled."""
        control, image = self.iteration_control, self.image
        self.path.connect(m, self.event_buffer, image)
        m.d.comb += [self.event_buffer.replay.eq(control.replay), self.event_buffer.room.eq(image.room)]
        v = self.ascent.warped if self.probe else self.ascent.v
        self.path.scale_and_warp(m, batch, reciprocal, v, self.ascent)
        following = control.next if self.config.slides else control.run.updated
        m.d.comb += [
            control.complete.eq(image.complete),
            image.next.eq(following | self._probed(m) if self.probe else following),
        ]
        if self.config.ascent_rule.strides:
            stride = self.ascent.stride
            m.d.comb += self.event_buffer.stride.eq(Mux(control.whole, 0, stride) if self.config.confidence else stride)
            self.path.replay_subsets(m, self.event_buffer)

    def _ascend(self, m):
        """The gradient of the sums moves v."""
        connect(m, self.image.sums, self.gradient.i)
        connect(m, self.iteration_control.run, self.ascent.run)
        m.d.comb += self.ascent.i.valid.eq(self.gradient.o.valid & self.iteration_control.iterating)
        m.d.comb += self.ascent.i.payload.eq(self.gradient.o.payload)
        if hasattr(self, "schedule_write"):
            connect(m, flipped(self.schedule_write), self.ascent.schedule_write)

    def _confide(self, m, events):
        """Means of a round's sums; how sure v is, if that is measured. ``events`` is n."""
        if self.rounds:
            self._average(m)
        if self.config.confidence:
            (self._confide_in_round if self.rounds else self._confide_in_probes)(m, events)

    def _confide_in_probes(self, m, events):
        """Behind the last iteration: more replays beside v; the gradients tell."""
        control, probe, judge = self.iteration_control, self.probe, self.judge
        connect(m, probe.o, self.ascent.probe)
        m.d.comb += [
            *(block.new_batch.eq(control.run.take) for block in (probe, judge)),
            probe.begin.eq(control.begin),
            probe.iterating.eq(control.iterating),
            probe.complete.eq(control.complete),
            probe.v.eq(self.ascent.v),
            probe.sums.valid.eq(self.image.sums.valid),
            probe.sums.payload.eq(self.image.sums.payload),
            probe.squares.eq(self.image.squares),
            judge.i.valid.eq(self.gradient.o.valid & control.probing),
            judge.i.payload.eq(self.gradient.o.payload),
            control.more.eq(probe.more),
            control.judged.eq(judge.done),
            judge.v.eq(self.ascent.v),
            judge.last.eq(probe.last),
            judge.squares.eq(probe.last_squares),
            judge.events.eq(events),
            judge.limit.eq(control.run.settings.confidence_limit),
            control.run.doubtful.eq(judge.doubtful),
        ]

    def _found_beside(self):
        """What a result has of v's confidence, but for the verdict."""
        if self.rounds:
            return {"sum_squares": self.means.o_squares, "curvature": self.ascent.curvature}
        last, squares = self.probe.last, self.probe.last_squares
        return {"sums": last, "sum_squares": squares, "curvature": self.judge.curvature}

    def _average(self, m):
        """The means of a round's sums."""
        m.d.comb += [
            self.means.new_batch.eq(delay(m, self.iteration_control.run.take, 1, name="forget", valid=True)),
            self.means.i.valid.eq(self.image.sums.valid),
            self.means.i.payload.eq(self.image.sums.payload),
        ]
        if self.config.confidence:
            m.d.comb += self.means.squares.eq(self.image.squares)

    def _confide_in_round(self, m, events):
        """The last round's evaluations tell, as soon as they are there."""
        control, verdict = self.iteration_control, self.judge
        if not verdict:  # who decides elsewhere has all that it takes
            m.d.comb += control.judged.eq(1)
            return
        judged, slides = Signal(name="judged"), self.config.slides
        m.d.sync += judged.eq((judged | verdict.done) & ~control.run.take)
        begin = self.means.done & control.run.final
        m.d.comb += [
            verdict.begin.eq(begin & control.wants_verdict if slides else begin),
            verdict.sum_i.eq(self.means.o.i),
            verdict.squares.eq(self.means.o_squares),
            verdict.curvature.eq(self.ascent.curvature),
            verdict.events.eq(events),
            verdict.limit.eq(control.run.settings.confidence_limit),
            control.judged.eq(judged if slides else judged | verdict.done),
            *([] if slides else [control.run.doubtful.eq(verdict.doubtful & control.run.settings.judge)]),
        ]

    def _probed(self, m):
        """A pulse: a probe is over, as ``updated`` says of an iteration."""
        return delay(m, self.judge.i.valid, self.ascent.latency, name="probed", valid=True)
