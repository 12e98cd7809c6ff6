"""Damage entries: escaped sentences, and a bounded number of entries."""

from collections.abc import Iterable

from schemas.bounds import MAX_INTEGER, MAX_TEXT
from schemas.visible import visible
from schemas.work import ChunkRef, Damage
from workers.ingest.limits import MAX_DAMAGE


def damaged(*, key: str, offset: int, length: int, what: str) -> Damage:
    """Describe a stretch that cannot be read; texts of the log in it are escaped and cut."""
    return Damage(
        key=key,
        offset=min(max(offset, 0), MAX_INTEGER),
        bytes=min(max(length, 0), MAX_INTEGER),
        what=visible(what, limit=MAX_TEXT),
    )


def damaged_chunk(key: str, ref: ChunkRef, what: str) -> Damage:
    """Describe a chunk that cannot be read."""
    return damaged(key=key, offset=ref.offset, length=ref.length, what=what)


class DamageList(list[Damage]):
    """Damage in the order it was found; beyond `MAX_DAMAGE` the last entry sums up the rest."""

    def __init__(self, found: Iterable[Damage] = ()) -> None:
        """Begin with some entries."""
        super().__init__()
        self._summed = 1
        self.extend(found)

    def append(self, each: Damage) -> None:
        """Add a stretch, or count it."""
        if len(self) < MAX_DAMAGE:
            super().append(each)
            return
        last, self._summed = self[-1], self._summed + 1
        self[-1] = damaged(
            key=last.key,
            offset=last.offset,
            length=last.bytes + each.bytes,
            what=f"{self._summed} more stretches cannot be read, the first of them here",
        )

    def extend(self, found: Iterable[Damage]) -> None:
        """Add several stretches."""
        for each in found:
            self.append(each)
