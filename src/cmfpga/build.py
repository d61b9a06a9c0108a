"""``python -m cmfpga.build``: the command ``cmfpga build``."""

import sys

from .cli import run
from .cli.build import main

if __name__ == "__main__":
    sys.exit(run(main))
