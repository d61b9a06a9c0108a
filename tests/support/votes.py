"""Images as the banks of the accumulators hold them."""


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
