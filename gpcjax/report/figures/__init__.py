"""The figures of a report.

matplotlib reads MPLBACKEND when it is first imported, and fails there if the value names no backend of this Python: a
notebook's kernel hands its own on to every program that it starts. No figure here needs a backend, so matplotlib is
imported without the variable, which is applied afterwards where it can be.
"""

import os

from gpcjax.errors import UserError


def _import_matplotlib() -> None:
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    except UnicodeDecodeError as error:
        raise UserError(
            f"matplotlib cannot read its file of settings, matplotlibrc: {error}; mend it"
        ) from None
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        try:
            matplotlib.rcParams["backend"] = backend
        except ValueError:
            return


_import_matplotlib()
