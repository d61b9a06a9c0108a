"""What follows from a configuration's fields."""


class Derived:
    """Base of the groups of derived values: attributes that follow from a :class:`~cmfpga.config.Config`."""

    def __init__(self, config):
        self._c = config
