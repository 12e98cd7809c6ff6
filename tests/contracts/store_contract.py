"""What every contract of the ledger begins with: an open store, and a world on it."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import pytest

from service.store.engine import Store
from tests.contracts.ledger_world import World


class StoreContract(ABC):
    """Tested on whatever `make_store` opens; it must open the same database again."""

    @abstractmethod
    def make_store(self) -> Store:
        """Open the test's database, empty at first."""

    @pytest.fixture
    def world(self) -> Iterator[World]:
        store = self.make_store()
        yield World.on(store)
        store.close()
