"""Votes and images as the banks of the accumulators have them."""


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
    images = {name: image.tolist() for name, image in zip(("i", "dx", "dy"), images, strict=True)}
    return [
        [{name: image[2 * row + (n >> 1)][2 * column + (n & 1)] for name, image in images.items()} for n in range(4)]
        for _, row, column in sweep_addresses(config)
    ]
