"""Accumulator against its model: no vote is lost however close two of them come, and a sweep leaves zeros."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.config import Config
from cmfpga.reference.integer.accumulator import accumulator
from cmfpga.reference.integer.voter import Votes, voter
from cmfpga.rtl.accumulator import Accumulator, ReadAddWrite

from .bench import (
    CONFIGS,
    NARROW,
    bank_pixels,
    corners,
    np,
    play,
    random_gaps,
    random_value,
    random_values,
    sweep_addresses,
    tensor,
    vote_payloads,
)

CONFIGS = {name: CONFIGS[name] for name in ("narrow", "odd", "tiny", "sensor")} | {
    # Odd numbers of columns and rows in a bank.
    "uneven": Config(roi_width=6, roi_height=10, buffer_events=40),
}


# ---------------------------------------------------------------- votes


def cell_votes(config, cells, rng):
    """Votes with random weights and derivatives into the 2×2 pixels at each (column, row)."""
    cells = np.array(cells, np.int64).reshape(-1, 2)
    shape = (len(cells), 4)
    column = cells[:, :1] + [0, 1, 0, 1]
    row = cells[:, 1:] + [0, 0, 1, 1]
    top = config.derivative_max
    return Votes(
        tensor((column >= 0) & (column < config.roi_width) & (row >= 0) & (row < config.roi_height)).bool(),
        tensor(column),
        tensor(row),
        w=tensor(rng.integers(0, config.weight_max, shape, endpoint=True)),
        dx=tensor(rng.integers(-top, top, shape, endpoint=True)),
        dy=tensor(rng.integers(-top, top, shape, endpoint=True)),
    )


def patterns(config, rng):
    """{name: cells} of the ways in which votes can follow one another."""
    width, height = config.roi_width, config.roi_height
    x, y = width // 2 - 1, height // 2 - 1
    count = min(40, config.buffer_events)

    def anywhere(count):
        return list(zip(rng.integers(-1, width, count).tolist(), rng.integers(-1, height, count).tolist(), strict=True))

    cells = {"no vote": [], "full": anywhere(config.buffer_events)}
    for number in (1, 2, 3, 5):
        cells[f"{number} votes"] = anywhere(number)
        cells[f"{number} votes on one pixel"] = [(x, y)] * number
    cells["one pixel"] = [(x, y)] * count
    cells["two cells alternating"] = [(x, y), (width - 2, 0)] * (count // 2)
    cells["neighbours alternating"] = [(x, y), (x + 1, y)] * (count // 2)
    for distance in range(1, 6):
        # `distance` cells in a bank, in turn, and a cell that comes back among others that do not.
        cells[f"repeats at distance {distance}"] = [(2 * (k % distance) % width, 0) for k in range(count)]
        cells[f"one in {distance}"] = [
            (0, 0) if k % distance == 0 else (2 + k % max(1, width - 3), height - 2) for k in range(count)
        ]
    cells["2×2 neighbours"] = [(x + k % 2, y + k // 2 % 2) for k in range(count)]
    cells["a walk by one pixel"] = [(k % width, k % height) for k in range(count)]
    cells["corners"] = [(c, r) for c in (-1, 0, width - 2, width - 1) for r in (-1, 0, height - 2, height - 1)] * 2
    cells["edges"] = [((-1, k % height), (k % width, -1), (width - 1, k % height), (k % width, height - 1))[k % 4]
                      for k in range(count)]  # fmt: skip
    cells["outside"] = [(-2, 0), (0, -2), (width, 0), (0, height), (-2, -2), (width, height)] * 2
    return cells


# ---------------------------------------------------------------- playing


def script_of(config, phases, rng, probability=0.0):
    """Votes of a phase, then a sweep, then the next phase: no cycle between them, but for random gaps.

    Whatever is not valid has random values: banks without a vote, votes in a gap or during a sweep.
    """
    block = Accumulator(config)
    votes_noise = random_values(block.i.payload.shape(), rng)
    vote_noise = random_values(block.i.payload.shape()["banks"].shape.elem_shape, rng)
    sweep_noise = random_values(block.sweep.payload.shape(), rng)
    script, starts = [], []

    def idle(cycles):
        script.extend({"i.payload": next(votes_noise)} for _ in range(cycles))

    for votes in phases:
        events = vote_payloads(config, votes)
        for banks, gap in zip(events, random_gaps(rng, len(events), probability), strict=True):
            idle(gap)
            banks = [bank or next(vote_noise) | {"valid": 0} for bank in banks]
            script.append({"i.valid": 1, "i.payload": {"banks": banks, "last": int(rng.integers(2))}})
        addresses = [address for address, *_ in sweep_addresses(config)]
        starts.append([])
        for address, gap in zip(addresses, random_gaps(rng, len(addresses), probability / 2), strict=True):
            idle(gap)
            starts[-1].append(len(script))
            sweep = next(sweep_noise) | {"address": address}
            script.append({"sweep.valid": 1, "sweep.payload": sweep})
    idle(8)
    return block, script, starts


def check(config, phases, probability=0.0, seed=0):
    """``phases`` is a dictionary {name: votes}."""
    rng = np.random.default_rng(seed)
    block, script, starts = script_of(config, phases.values(), rng, probability)
    recording = play(block, script)
    expected = {name: bank_pixels(config, accumulator(config, votes)) for name, votes in phases.items()}
    values = iter(recording.values())
    for name, pixels in expected.items():
        for place, wanted in zip(sweep_addresses(config), pixels, strict=True):
            assert next(values, "nothing more") == wanted, f"{name!r} at address, row, column {place}"
    assert next(values, None) is None, "more items than were swept"
    swept = [cycle for cycles in starts for cycle in cycles]
    assert recording.cycles() == [cycle + block.latency for cycle in swept]
    return expected


@pytest.mark.parametrize("probability", [0.0, 0.5], ids=["free", "gaps"])
@pytest.mark.parametrize("name", ["narrow", "odd", "tiny", "uneven"])
def test_hazards(name, probability, rng):
    """All patterns, back to back, each followed at once by its sweep; in between, sweeps that must read zeros."""
    config = CONFIGS[name]
    nothing = cell_votes(config, [], rng)
    phases = {}
    for pattern, cells in patterns(config, rng).items():
        phases[pattern] = cell_votes(config, cells, rng)
        if len(phases) % 8 == 0:
            phases[f"zeros after {pattern!r}"] = nothing
    check(config, phases, probability)


@pytest.mark.parametrize("name", ["narrow", "odd"])
def test_votes_of_the_voter(name, rng):
    """What the voter really gives, events along a moving edge."""
    config = CONFIGS[name]
    phases = {}
    for batch in range(3):
        count = config.buffer_events
        frac = config.position_frac
        x = (rng.integers(-1, 4, count) + config.roi_width // 2 << frac) + rng.integers(0, 1 << frac, count)
        y = rng.integers(-2 << frac, (config.roi_height + 1) << frac, count)
        dt = rng.integers(-1 << config.dt_frac, 1 << config.dt_frac, count, endpoint=True)
        phases[f"batch {batch}"] = voter(config, tensor(x), tensor(y), tensor(dt))
    check(config, phases)


def test_whole_sensor(rng):
    """240×180: votes at the far ends of the address range."""
    config = CONFIGS["sensor"]
    far = [(239, 179), (238, 178), (239, 0), (0, 179), (-1, -1), (127, 127), (128, 128)] * 5
    check(config, {"far": cell_votes(config, far, rng)})


@pytest.mark.parametrize("sign", [-1, 1])
def test_words_hold_every_event_on_one_pixel(sign):
    """As many events as the buffer holds, with the largest votes, on one pixel: the largest words that can be."""
    config = Config(**NARROW).replace(buffer_events=64, roi_width=4, roi_height=4)
    votes = cell_votes(config, [(1, 1)] * config.buffer_events, np.random.default_rng(0))
    top = sign * config.derivative_max
    votes = votes._replace(w=votes.w * 0 + config.weight_max, dx=votes.dx * 0 + top, dy=votes.dy * 0 - top)
    largest = {
        "i": config.image_max,
        "dx": sign * config.derivative_image_max,
        "dy": -sign * config.derivative_image_max,
    }
    expected = check(config, {"full": votes, "zeros": cell_votes(config, [], np.random.default_rng(0))})
    assert largest in expected["full"][0]


def test_latency_and_throughput(rng):
    """A vote, or a swept address, in every cycle: asserted by :func:`check` for every item; here the number."""
    config = CONFIGS["odd"]
    assert Accumulator.latency == ReadAddWrite.latency == 3
    block, script, starts = script_of(config, [cell_votes(config, [(0, 0)] * 20, rng)], rng)
    recording = play(block, script)
    assert starts[0] == list(range(20, 20 + config.bank_words))
    assert recording.cycles() == list(range(23, 23 + config.bank_words))


@corners
@given(st.data())
def test_any_order_of_few_addresses(data):
    """Votes among few cells, with gaps of any pattern: where forwarding works."""
    config = CONFIGS["uneven"]
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    cell = st.tuples(st.sampled_from([0, 1, 2]), st.sampled_from([0, 2]))
    phases = {}
    for phase in range(3):
        cells = data.draw(st.lists(cell, min_size=3, max_size=config.buffer_events))
        phases[f"phase {phase}"] = cell_votes(config, cells, rng)
    check(config, phases, data.draw(st.sampled_from([0.0, 0.3, 0.6])), seed=data.draw(st.integers(0, 1000)))


def test_read_add_write_gives_the_value_before(rng):
    """The bank alone: every operation returns what stood there before it, clears included."""
    from amaranth.hdl import signed
    from amaranth.lib import data

    word = data.StructLayout({"a": 12, "b": signed(14)})
    block = ReadAddWrite(word, data.StructLayout({"a": 5, "b": signed(6)}), 5)
    memory = [{"a": 0, "b": 0} for _ in range(5)]
    script, expected = [], []
    for _ in range(600):
        operation = random_value(block.operation, rng) | {"address": int(rng.choice([0, 0, 1, 4])), "clear": 0}
        operation["clear"] = int(rng.random() < 0.1)
        if rng.random() < 0.2:
            script.append({"i.payload": operation})
            continue
        script.append({"i.valid": 1, "i.payload": operation})
        old = memory[operation["address"]]
        expected.append(old)
        add = operation["add"] if not operation["clear"] else {name: -value for name, value in old.items()}
        memory[operation["address"]] = {name: old[name] + add[name] for name in old}
    recording = play(block, [*script, *[{}] * 6])
    assert recording.values() == expected
    pushed = [cycle for cycle, values in enumerate(script) if "i.valid" in values]
    assert [out - into for out, into in zip(recording.cycles(), pushed, strict=True)] == [block.latency] * len(pushed)
