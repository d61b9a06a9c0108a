"""``cmfpga sweep``."""

import sys

from .. import cli
from ..cli.sweep import main

if __name__ == "__main__":
    sys.exit(cli.run(main))
