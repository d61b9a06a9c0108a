"""``cmfpga flow``."""

import sys

from .. import cli
from ..cli.flow import main

sys.exit(cli.run(main))
