"""The command line: its grammar (`flags`, `commands`, `words`), what commands do (`running`, `showing`), `entry`."""

from gpcjax.cli.entry import BROKEN_PIPE, FAILED, MISTAKE, main
from gpcjax.cli.running import FAULT, usable_cores

__all__ = ["BROKEN_PIPE", "FAILED", "FAULT", "MISTAKE", "main", "usable_cores"]
