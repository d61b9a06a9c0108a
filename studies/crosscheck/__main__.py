"""``python -m studies.crosscheck``."""

import sys

from cmfpga import cli

from . import main

if __name__ == "__main__":
    sys.exit(cli.run(main))
