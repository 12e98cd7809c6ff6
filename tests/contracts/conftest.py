"""Servers that contracts run against."""

from collections.abc import Iterator

import pytest

from tests.contracts.databases import postgres_server


@pytest.fixture(scope="session")
def postgres() -> Iterator[str]:
    """A PostgreSQL of our own, as the URL in front of a database's name."""
    with postgres_server() as url:
        yield url
