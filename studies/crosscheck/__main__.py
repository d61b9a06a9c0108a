"""``python -m studies.crosscheck``."""

import sys

from cmfpga import cli

from . import main

sys.exit(cli.run(main))
