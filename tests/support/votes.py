"""Votes for the accumulators, and the ways in which they can follow one another."""

import numpy as np

from cmfpga.reference.integer.voter import Votes
from support.values import tensor


def cell_votes(config, cells, rng):
    """Votes with random weights and derivatives into the 2×2 pixels at each (column, row)."""
    cells = np.array(cells, np.int64).reshape(-1, 2)
    shape = (len(cells), 4)
    column = cells[:, :1] + [0, 1, 0, 1]
    row = cells[:, 1:] + [0, 0, 1, 1]
    top = config.widths.derivative_max
    return Votes(
        tensor((column >= 0) & (column < config.roi_width) & (row >= 0) & (row < config.roi_height)).bool(),
        tensor(column),
        tensor(row),
        w=tensor(rng.integers(0, config.widths.weight_max, shape, endpoint=True)),
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


def vote_payloads(config, votes):
    """Model votes as payloads of :func:`cmfpga.rtl.payloads.votes`: sorted by bank, None where there is no vote."""
    names = ("inside", "column", "row", "w", "dx", "dy")
    payloads = []
    for event in zip(*(getattr(votes, name).tolist() for name in names), strict=True):
        banks = [None] * 4
        for inside, column, row, w, dx, dy in zip(*event, strict=True):
            number = 2 * (row & 1) + (column & 1)
            address = ((row >> 1) << config.geometry.bank_column_bits) | (column >> 1)
            if inside:
                banks[number] = {"valid": 1, "address": address, "i": w, "dx": dx, "dy": dy}
        payloads.append(banks)
    return payloads


def sweep_addresses(config):
    """Addresses of a bank in the order of a sweep, as (address, row, column) of the bank."""
    return [
        ((row << config.geometry.bank_column_bits) | column, row, column)
        for row in range(config.geometry.bank_rows)
        for column in range(config.geometry.bank_columns)
    ]


def bank_pixels(config, images):
    """The images as a sweep reads them: for each address the four banks' words."""
    i, dx, dy = (image.tolist() for image in images)
    pixels = []
    for _, bank_row, bank_column in sweep_addresses(config):
        words = []
        for number in range(4):
            row, column = 2 * bank_row + (number >> 1), 2 * bank_column + (number & 1)
            words.append({"i": i[row][column], "dx": dx[row][column], "dy": dy[row][column]})
        pixels.append(words)
    return pixels
