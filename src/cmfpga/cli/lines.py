"""What ``track`` prints of its batches; consumers, as :mod:`cmfpga.tracking.loop` takes them."""

import json
import sys

from . import wrote
from .truth import accuracy_lines


class Truth(list):
    """Lines that show the true motion beside the found one, batch by batch; a consumer."""

    MOST = 16  # that :meth:`shown` has of windows that overlap

    def __init__(self, motion):
        self._motion = motion

    def shown(self, config):
        """Its lines with a title; of windows that slide some, evenly."""
        step = max(1, round(len(self) / self.MOST)) if config.slides else 1
        every = f"   (every {step}th window; all are in track.csv)" if step > 1 else ""
        return [f"{config.noun:6}  true vx, vy [px/s]      found vx, vy [px/s]{every}", *self[::step]]

    def add(self, batch):
        speed = batch.v_px_per_s
        if speed is None:
            self.append(f"{batch.index:5}   (degenerate)")
            return
        true = batch.true_px_per_s(self._motion)
        self.append(f"{batch.index:5}   {true[0]:8.1f} {true[1]:8.1f}       {speed[0]:8.1f} {speed[1]:8.1f}")


class Lines:
    """Prints a line for each batch of a stream as it is found, of one of several objects with its name; a consumer."""

    def __init__(self, as_json, name=""):
        self._as_json, self._name = as_json, name

    def add(self, batch):
        if self._as_json:
            print(json.dumps({**({"name": self._name} if self._name else {}), **batch.values}), flush=True)
            return
        (x, y), speed = (at << batch.config.binning for at in batch.result.roi_next), batch.v_px_per_s
        at = "" if batch.t_ref is None else f"{batch.t_ref / 1e6:.6f} s"
        found = "no motion" if speed is None else f"{speed[0]:8.1f} {speed[1]:8.1f} px/s"
        name = f"{self._name}: " if self._name else ""
        print(f"{name}{batch.index:5}  {at}  {found:>22}  next ROI {x},{y}  {batch.flags.text}".rstrip(), flush=True)


def print_remarks(objects):
    """Warnings and notes of a list of TrackedObject, on standard error."""
    for one in objects:
        for kind, sentence in one.remarks:
            print(f"{kind}: {f'{one.name}: ' * bool(one.name)}{sentence}", file=sys.stderr)


def print_summary(objects, *, engine, cycles, clock, as_json, counts):
    """Print what a track of a list of TrackedObject found.

    ``engine`` is its name, ``cycles`` of each batch are those of all objects together, none of an engine without a
    clock, ``clock`` is in MHz, ``counts`` of a stream as :meth:`cmfpga.events.LiveSource.counts` tells it, or None.
    """
    names = [f"{one.name}: " * bool(one.name) for one in objects]
    print_remarks(objects)
    if as_json:
        entries = [one.summary() for one in objects]
        if len(objects) > 1:
            for entry in entries:
                del entry["cycles"]
            entries = [{"batches": objects[0].batches, "cycles": sum(cycles) or None, "objects": entries}]
        summary = {"engine": engine, **entries[0], "config": objects[0].config.to_dict()}
        print(json.dumps(summary, indent=2) if counts is None else json.dumps({"summary": {**summary, **counts}}))
        return
    for name, one in zip(names, objects, strict=True):
        print(
            f"{name}{one.batches} {one.config.nouns} tracked ({engine} engine), {one.warned} with warnings, "
            f"{one.cutter.leftover} events left over"
        )
        verdict = one.verdict
        for sentence in (one.image_text, one.dropped_text, verdict.share, verdict.velocity, verdict.motion_text):
            if sentence:
                print(f"{name}{sentence}")
    if cycles:
        mean = sum(cycles) / len(cycles)
        print(
            f"{mean:,.0f} clock cycles a {objects[0].config.noun} on average, {mean / clock / 1e3:.3f} ms at an "
            f"assumed clock of {clock:g} MHz"
        )
    if counts:
        if "driver_dropped" in counts:
            ring = f"{counts['driver_backlog']} packets waited in the driver at most, {counts['driver_dropped']}"
            times = {0: "", 1: "; it was gone once"}.get(n := counts["reconnected"], f"; it was gone {n} times")
            waited = f"{ring} were dropped there{times}"
        else:
            waited = f"the sender was held up for {counts['held_up_s']:g} s"
        print(f"{counts['received']} events came, {counts['lost']} were dropped; {waited}")
        for name, what in (
            ("out_of_sensor", "events lay outside the sensor"),
            ("not_tracked", "events were not tracked any more"),
            ("before_time", "events came before the first time word and were left out"),
            ("wrong_times", "time words were wrong and were left out"),
        ):
            if counts[name]:
                print(f"{counts[name]} {what}")
    for name, one in zip(names, objects, strict=True):
        for line in accuracy_lines(one.accuracy) if one.accuracy else ():
            print(f"{name}{line}")
    wrote(path for one in objects for path in one.files)
