"""Searches of these tests are kept where no power fails: nobody waits for the disk."""

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
