"""What is known of noise: pixels that are to be masked."""

from ..errors import ConfigError


def parse_pixels(text, config):
    """The pixels of ``x,y;x,y;…``: tuple of (column, row), sorted, each once.

    Raises :exc:`ConfigError` where the text is malformed, or a pixel lies outside the sensor.
    """
    found = set()
    for word in filter(None, text.replace(" ", "").split(";")):
        column, comma, row = word.partition(",")
        if not (comma and column.isdecimal() and row.isdecimal() and len(word) < 20):
            raise ConfigError(f"hot_mask: {word[:40]!r}: X,Y of a pixel is needed, pixels separated by ';'")
        pixel = int(column), int(row)
        if pixel[0] >= config.sensor_width or pixel[1] >= config.sensor_height:
            raise ConfigError(
                f"hot_mask: pixel {word}: 0,0 to {config.sensor_width - 1},{config.sensor_height - 1} is needed"
            )
        found.add(pixel)
    return tuple(sorted(found))
