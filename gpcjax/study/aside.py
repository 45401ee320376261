"""The report of a study that goes on, made in a process of its own, which no step of a run waits for."""

import asyncio
import os
import sys
from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.study.register import ANALYSIS
from gpcjax.study.report.run import PAGE, draw

NICE = 15
"""It takes what the runs leave of the processor."""

LONGEST = 300.0
"""Seconds that it may take."""

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Of its page, which holds its figures and its style, and no script."""


async def drawn(out: Path) -> Path:
    """Makes the report of a study's folder; gives its page.

    Raises:
        UserError: it cannot be made; the message is that of `gpcjax.study.report.run.draw`.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", __name__, str(out.absolute()), stderr=asyncio.subprocess.PIPE
    )
    try:
        _, errors = await asyncio.wait_for(process.communicate(), LONGEST)
    except TimeoutError:
        raise UserError(f"{out}: the report takes longer than {LONGEST:.0f} seconds") from None
    finally:
        if process.returncode is None:  # also when the server ends meanwhile
            process.kill()
            await process.wait()
    if process.returncode:
        lines = errors.decode(errors="replace").strip().splitlines()
        raise UserError(lines[-1] if lines else f"{out}: the report could not be made")
    return out / ANALYSIS / PAGE


def main() -> int:
    """In the process of its own."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    try:
        draw(Path(sys.argv[1]), lambda line: print(line, file=sys.stderr))
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
