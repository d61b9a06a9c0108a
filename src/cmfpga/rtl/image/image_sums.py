"""The seam between the voter and the gradient: whatever sums an iteration's votes."""

from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block, payloads


class ImageSums(Block):
    """A way to sum an iteration's votes. Each is a subclass, listed in :data:`cmfpga.rtl.image.IMAGES`.

    Votes cannot be stalled. Where an image is short of room it says so early, and the event buffer waits.

    Parameters
    ----------
    in_flight : int
        Events that may still come after ``room`` has gone away.
    pixels : bool
        Whether it shows its images.
    images : int
        Filled side by side, of a round's four evaluations.

    Members
    -------
    votes : ``In``, flow of :func:`payloads.votes`
        The events of an iteration; ``last`` marks its last. An array of flows, where images are filled side by side.
    room : ``Out(1)``
        As many events as are in flight still fit: the event buffer issues the next one.
    complete : ``Out(1)``
        All of an iteration has been taken in: ``sums`` follow :attr:`latency` cycles later.
    sums : ``Out``, flow of :func:`payloads.sums`
        One item an iteration; the payload stays until the next iteration's first vote. Of a round's four evaluations
        four items, in successive cycles.
    squares : ``Out``, :func:`payloads.squares`
        Σ I², with ``sums``. Only where v's confidence is measured.
    next : ``In(1)``
        v has been updated: what comes now is another iteration.
    clear, cleared : ``In(1)``, ``Out(1)``
        After a reset, clear what a reset does not, and say when that is done. A pulse each.
    pixels : ``Out``, flow of an array of four :func:`payloads.pixel`
        For verification; not in every image.

    Attributes
    ----------
    latency : int
        Cycles from ``complete`` to the last item of ``sums``.
    lead : int
        ΣI and ΣD are final so many cycles before ``sums``, :attr:`Gradient.lead` or more.
    sweep_cycles : int
        Cycles from an iteration's last vote to ``complete``, if there is always room.
    blocks : dict
        The parts by name, in the order of data flow.
    """

    lead = 3
    sweep_cycles = 0

    def __init__(self, config, *, in_flight, pixels=False, images=1):
        self.config, self.in_flight = config, in_flight
        votes = In(payloads.flow(payloads.votes(config)))
        members = {
            "votes": votes.array(images) if images > 1 else votes,
            "room": Out(1, init=1),
            "complete": Out(1),
            "sums": Out(payloads.flow(payloads.sums(config))),
            **dict.fromkeys(("next", "clear"), In(1)),
            "cleared": Out(1),
        }
        if config.confidence:
            members["squares"] = Out(payloads.squares(config))
        if pixels:
            members["pixels"] = Out(payloads.flow(data.ArrayLayout(payloads.pixel(config), 4)))
        super().__init__(**members)

    @property
    def blocks(self):
        return {"image": self}

    def check(self, idle_cycles):
        """Whether it can work where no vote comes for ``idle_cycles`` between two iterations; else an error."""
