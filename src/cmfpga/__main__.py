"""``python -m cmfpga``: the command ``cmfpga``."""

import sys

from .cli.command import entry

if __name__ == "__main__":
    sys.exit(entry())
