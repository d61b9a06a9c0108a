"""``python -m cmfpga.crosscheck``."""

import sys

from .. import cli
from . import main

if __name__ == "__main__":
    sys.exit(cli.run(main))
