"""Record of overlays that no current scene needs, or that were deleted; filled by settings."""

from collections.abc import Callable, Sequence
from typing import Final

from service.store import retirement
from service.store.engine import Store
from service.store.retirement import SceneOverlay

AT_ONCE: Final = 1000
"""Overlays per transaction, so that no commit waits for long."""


class RetiredOverlays:
    """Records since when overlays are not needed; every write is on disk when it returns.

    Raises (every method):
        StoreUnavailableError: Transient: disk full, database locked for too long.
    """

    def __init__(self, store: Store, *, now_s: Callable[[], float]) -> None:
        """Keep the ledger's database and clock."""
        self._store, self._now_s = store, now_s

    def note(self) -> None:
        """Record overlays that have become unused, and remove those that are needed again."""
        with self._store.reading() as reading:
            for overlays in retirement.newly_retired(reading, portion=AT_ONCE):
                with self._store.writing() as connection:
                    retirement.note_retired(connection, overlays, now_s=self._now_s())
            for overlays in retirement.needed_again(reading, portion=AT_ONCE):
                with self._store.writing() as connection:
                    retirement.forget(connection, overlays)

    def to_delete(
        self, *, keep_s: float, limit: int, keep_pipelines: Sequence[str] = ()
    ) -> list[SceneOverlay]:
        """Return overlays unused for this long that no pending work may need, oldest first.

        Those of pipeline versions that begin with one of `keep_pipelines` are kept.
        """
        with self._store.reading() as connection:
            return retirement.to_delete(
                connection,
                before_s=self._now_s() - keep_s,
                limit=limit,
                keep_pipelines=keep_pipelines,
            )

    def note_deleted(self, overlays: Sequence[SceneOverlay]) -> None:
        """Record the deletion of these overlays."""
        if overlays:
            with self._store.writing() as connection:
                retirement.note_deleted(connection, overlays, now_s=self._now_s())

    def low_ranked(self, *, limit: int, keep_pipelines: Sequence[str] = ()) -> list[SceneOverlay]:
        """Return overlays of current scenes, the lowest score first; none selected or judged."""
        with self._store.reading() as connection:
            return retirement.low_ranked(connection, limit=limit, keep_pipelines=keep_pipelines)

    def is_deleted(self, overlay: SceneOverlay) -> bool:
        """Return true if the service has deleted this overlay."""
        with self._store.reading() as connection:
            return retirement.is_deleted(connection, overlay)
