"""Plays batches into an ascent, and compares v, its flag and the updates with what they must be, in every cycle."""

from support.bench import held, play
from support.values import random_value


class Player:
    """The script so far, ``v`` and whether it was ``saturated`` in this batch, and when they change.

    What has no strobe is random; the settings, too, but for those that are told.
    """

    def __init__(self, block, rng):
        self.block, self.rng, self.names = block, rng, block.config.motion_model.names
        self.settings = random_value(block.run.settings.shape(), rng)
        self.v, self.saturated = (0,) * len(self.names), False
        self.script, self.timeline, self.entered = [], {0: (self.v, False)}, []

    def named(self, numbers):
        return dict(zip(self.names, numbers, strict=True))

    def cycle(self, count=1, **values):
        for _ in range(count):
            noise = {"i.payload": random_value(self.block.i.payload.shape(), self.rng)}
            self.script.append(noise | {"run.settings": self.settings} | values)

    def begin(self, start, wait=0, **settings):
        """A batch that takes these settings, and ``wait`` cycles later starts at v, or goes on if that is None."""
        self.cycle(**{"run.take": 1})
        self.settings = random_value(self.block.run.settings.shape(), self.rng) | settings
        self.settings |= {} if start is None else {"v_start": self.named(start)}
        self.saturated = False
        self.timeline[len(self.script)] = self.v, self.saturated
        self.cycle(wait)
        self.cycle(**{"run.start": 1})
        if start is not None:
            self.v = tuple(start)
            self.timeline[len(self.script)] = self.v, self.saturated

    def give(self, *gradients):
        """One after the other; the last of them leads to :meth:`step`."""
        for g in gradients:
            self.cycle(**{"i.valid": 1, "i.payload": self.named(g)})
        self.entered.append(len(self.script) - 1)

    def step(self, v, limited):
        self.v, self.saturated = tuple(v), self.saturated or bool(limited)
        self.timeline[self.entered[-1] + self.block.latency] = self.v, self.saturated

    def check(self, *more):
        """What the block did; ``more`` is watched, too."""
        watch = play(self.block, self.script, flows=(), watch=("v", "saturated", "run.updated", "limited", *more)).watch
        for number, wanted in enumerate(held(self.timeline, len(self.script))):
            assert (tuple(watch["v"][number].values()), watch["saturated"][number]) == wanted, f"cycle {number}"
        updated = [number for number, value in enumerate(watch["run.updated"]) if value]
        assert updated == [number + self.block.latency for number in self.entered]
        assert not any(watch["limited"])
        return watch
