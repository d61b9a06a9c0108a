"""Basis, flow and moments against their model, at any position, camera and velocity."""

import numpy as np
import pytest
import torch

from cmfpga.config import preset
from cmfpga.reference.integer import motion as model
from cmfpga.reference.integer.image import Votes
from cmfpga.rtl import payloads
from cmfpga.rtl.image.basis import Basis
from cmfpga.rtl.image.flow import Flow
from cmfpga.rtl.image.moments import Moments
from support.bench import play
from support.core_batches import CONFIGS
from support.values import edge_integers, random_value, tensor

SHAPES = {
    "similarity": preset("similarity"),
    "rotation": preset("rotation"),
    "small similarity": CONFIGS["similarity"],
    "small rotation": CONFIGS["rotation"],
    # No dither, and one that is coarser than the basis.
    "plain": preset("similarity").replace(dither_frac=0, roi_width=30, roi_height=17),
    "coarse": preset("similarity").replace(dither_frac=1),
}
COUNT = 200


def places(config, rng):
    """Columns and rows of dithered events in the ROI, raw."""
    half = (1 << config.formats.dithered_frac) >> 1
    return [
        edge_integers(rng, -half, ((size - 1) << config.formats.dithered_frac) + max(0, half - 1), COUNT)
        for size in (config.roi_width, config.roi_height)
    ]


@pytest.mark.parametrize("name", SHAPES)
def test_basis(name, rng):
    """One event a cycle, so that stages that do not wait for each other are found; a camera at every limit."""
    config = SHAPES[name]
    block = Basis(config)
    saturated = 0
    for focus in (33.0, 200.0, 5000.0):
        x, y = places(config, rng)
        more = (1 << config.formats.dithered_frac) >> 1 if config.formats.event_frac else 0
        script = [{"x": a + more, "y": b + more} for a, b in zip(x.tolist(), y.tolist(), strict=True)]
        corner = tuple(int(rng.integers(most + 1)) for most in (config.geometry.roi_x_max, config.geometry.roi_y_max))
        lens = (focus, focus, *rng.uniform(0, (config.sensor_width - 1, config.sensor_height - 1)))
        if config.motion == "rotation":
            centre, bend = config.motion_model.centre(lens), config.motion_model.curve(lens)
            assert bend < 1 << config.motion_model.curve_bits
            still = {"centre": dict(zip("xy", centre, strict=True)), "curve": bend}
            script[0] |= still | {"corner": dict(zip("xy", corner, strict=True))}
            script.insert(0, script[0])  # the middle is known a cycle later
        recording = play(block, script + [{}] * block.latency, flows=(), watch=("o",))
        came = recording.watch["o"][len(script) - COUNT + block.latency :]
        found = model.basis(config, tensor(x), tensor(y), roi=corner, camera=lens)
        wanted = [
            dict(zip(found, values, strict=True)) for values in zip(*(v.tolist() for v in found.values()), strict=True)
        ]
        assert came == wanted and set(found) == set(config.motion_model.basis)
        saturated += sum(row.get("xx") == config.motion_model.basis["xx"].max for row in wanted if "xx" in row)
        for member, values in found.items():
            fmt = config.motion_model.basis[member]
            assert fmt.min <= int(values.min()) and int(values.max()) <= fmt.max, member
    if name == "rotation":
        assert saturated


@pytest.mark.parametrize("name", SHAPES)
def test_flow(name, rng):
    """Each event with a velocity of its own, at the limits of all formats."""
    config = SHAPES[name]
    motion, block = config.motion_model, Flow(config)
    b = {name: edge_integers(rng, q.min, q.max, COUNT) for name, q in motion.basis.items()}
    v = [edge_integers(rng, p.fmt.min, p.fmt.max, COUNT) for p in motion.parameters]
    script = [
        {
            "basis": {name: int(values[k]) for name, values in b.items()},
            "v": {name: int(values[k]) for name, values in zip(motion.names, v, strict=True)},
        }
        for k in range(COUNT)
    ]
    came = play(block, script + [{}] * block.latency, flows=(), watch=("o",)).watch["o"][block.latency :]
    wanted = model.flow(config, [tensor(each) for each in v], {name: tensor(values) for name, values in b.items()})
    assert came == [{"x": x, "y": y} for x, y in zip(*(axis.tolist() for axis in wanted), strict=True)]


@pytest.mark.parametrize("name", SHAPES)
def test_moments(name, rng, monkeypatch):
    """Iterations one behind the other, of events and of cycles without one; increments as large as can be."""
    config = SHAPES[name]
    motion = config.motion_model
    top = config.max_level
    block = Moments(config)
    most = config.widths.growth_max
    script, wanted = [], []
    for events in (1, 2, 30, 5):
        grown = [edge_integers(rng, -most, most, events) for _ in range(2)]
        b = {name: edge_integers(rng, q.min, q.max, events) for name, q in motion.basis.items()}
        far = {axis: {name: edge_integers(rng, -most, most, events) for name in "pq"} for axis in "xy"}
        level = int(rng.integers(top, endpoint=True))
        for k in range(events):
            script.append({"begin": int(k == 0), "growth_x": int(grown[0][k]), "growth_y": int(grown[1][k])})
            script[-1]["basis"] = {name: int(values[k]) for name, values in b.items()}
            if motion.of_pixels:  # the level stands with the first event only
                now = {axis: {name: int(values[k]) for name, values in each.items()} for axis, each in far.items()}
                script[-1] |= {"far": now, "level": int(rng.integers(top, endpoint=True)) if k else level}
            if rng.random() < 0.3:
                script.append({"growth_x": 0, "growth_y": 0, "basis": random_value(payloads.basis(config), rng)})
                if motion.of_pixels:
                    script[-1]["far"] = dict.fromkeys("xy", dict.fromkeys("pq", 0))
        if motion.of_pixels:
            s = by_hand(motion, grown, b, far, level)
        else:
            with monkeypatch.context() as patch:
                patch.setattr(model, "growths", lambda *_, grown=grown: [tensor(each) for each in grown])
                s = model.moments(config, None, None, {name: tensor(values) for name, values in b.items()}, 0)
        wanted.append((len(script) - 1 + block.latency, dict(zip(motion.names, s, strict=True))))
    still = {"far": dict.fromkeys("xy", dict.fromkeys("pq", 0))} if motion.of_pixels else {}
    script += [{"growth_x": 0, "growth_y": 0, **still}] * block.latency
    came = play(block, script, flows=(), watch=("o",)).watch["o"]
    assert [came[cycle] for cycle, _ in wanted] == [sums for _, sums in wanted]


def by_hand(motion, grown, b, far, level):
    """S of each parameter: what the right pixels add has a p that is a pixel larger, the lower ones such a q."""
    grown = {axis: [int(value) for value in values] for axis, values in zip("xy", grown, strict=True)}
    pixel, found = 1 << (level + motion.place_frac), []
    for name in motion.names:
        s = sum(grown[name]) << motion.frac if name in grown else 0
        for axis, member, sign in motion.factors(name):
            s += sign * sum(g * int(at) for g, at in zip(grown[axis], b[member], strict=True))
            s += sign * pixel * sum(map(int, far[axis][member]))
        found.append(s)
    return found


def test_growths_add_up_to_the_sums_of_the_images(rng):
    """One event after the other, in whatever order: Σ I·D; and each is within its bound."""
    config = CONFIGS["similarity"]
    n, width = 300, config.roi_width
    column, row = (torch.tensor(rng.integers(0, 6, (n, 4))) for _ in range(2))
    w, dx, dy = (torch.tensor(rng.integers(low, 17, (n, 4))) for low in (0, -16, -16))
    votes = Votes(torch.tensor(rng.random((n, 4)) < 0.9), column, row, w, dx, dy)
    images = np.zeros((3, 6 * width + 6), np.int64)
    for there, c, r, *values in zip(*(part.flatten().tolist() for part in votes), strict=True):
        images[:, r * width + c] += np.array(values) * there
    found = [int(each.sum()) for each in model.growths(config, votes)]
    assert found == [int((images[0] * images[1]).sum()), int((images[0] * images[2]).sum())]
