"""``python -m cmfpga``: the command ``cmfpga``."""

import sys

from .command import entry

if __name__ == "__main__":
    sys.exit(entry())
