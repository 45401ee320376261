"""`python -m gpcjax` is the command `gpcjax`."""

from gpcjax.cli import main

if __name__ == "__main__":  # worker processes import this file again
    raise SystemExit(main())
