"""The ledger's memory of overlays that no current scene needs; filled only where asked for."""

from collections.abc import Callable, Sequence
from typing import Final

from service.store import retirement
from service.store.engine import Store
from service.store.retirement import SceneOverlay

AT_ONCE: Final = 1000
"""Overlays noted in one transaction, so that no commit waits for long."""


class RetiredOverlays:
    """Notes since when overlays are not needed; every write is on disk when it returns.

    Raises (every method):
        StoreUnavailableError: Transient: disk full, database locked for too long.
    """

    def __init__(self, store: Store, *, now_s: Callable[[], float]) -> None:
        """Take the ledger's database and clock."""
        self._store, self._now_s = store, now_s

    def note(self) -> None:
        """Note what is not needed since now, and forget what is needed again."""
        with self._store.reading() as reading:
            for overlays in retirement.newly_retired(reading, portion=AT_ONCE):
                with self._store.writing() as connection:
                    retirement.note_retired(connection, overlays, now_s=self._now_s())
            for overlays in retirement.needed_again(reading, portion=AT_ONCE):
                with self._store.writing() as connection:
                    retirement.forget(connection, overlays)

    def to_delete(self, *, keep_s: float, limit: int) -> list[SceneOverlay]:
        """Those noted so long ago that nothing has needed or may soon need again, oldest first."""
        with self._store.reading() as connection:
            return retirement.to_delete(connection, before_s=self._now_s() - keep_s, limit=limit)

    def note_deleted(self, overlays: Sequence[SceneOverlay]) -> None:
        """Note that these are gone."""
        if overlays:
            with self._store.writing() as connection:
                retirement.note_deleted(connection, overlays)
