"""Searches of these tests are kept where no power fails: nobody waits for the disk."""

import functools

import pytest


@pytest.fixture(scope="session", autouse=True)
def commits_at_once():
    from sqlalchemy import event
    from sqlalchemy.engine import Engine

    def unsafe(connection, _):
        connection.execute("PRAGMA synchronous=OFF")

    event.listen(Engine, "connect", unsafe)
    yield
    event.remove(Engine, "connect", unsafe)


@pytest.fixture(scope="session", autouse=True)
def revisions_read_once():
    """Whoever opens a database reads all that Optuna's databases have ever been, which declares their tables anew."""
    from alembic import util

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(util, "load_python_file", functools.cache(util.load_python_file))
        yield
