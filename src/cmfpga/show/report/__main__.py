"""``cmfpga report``."""

import sys

from ... import cli
from ...cli.report import main

sys.exit(cli.run(main))
