"""Output of an export in a bucket: scenes are sent whole, then the journal that names them."""

from pathlib import Path

from schemas.transport.bucket import Bucket, ObjectMeta
from service.errors import StateInUseError


class BucketSink:
    """Sends the files of an export to a bucket.

    A bucket has no lock: two exports at once are recognised by a journal that changed in between.
    """

    def __init__(self, bucket: Bucket) -> None:
        """Keep the bucket, whose URL has the prefix of the export."""
        self._bucket = bucket
        self._journal: ObjectMeta | None = None

    @property
    def url(self) -> str:
        """URL of the output."""
        return self._bucket.url

    def is_empty(self) -> bool:
        """Return True if nothing lies below the URL."""
        return next(iter(self._bucket.list()), None) is None

    def has(self, place: str) -> bool:
        """Return True if an object, or a folder with objects, lies at this place."""
        return next(iter(self._bucket.list(place)), None) is not None or (
            self._bucket.head(place) is not None
        )

    def send(self, path: Path, place: str) -> None:
        """Store a file, or a folder file by file, and delete what it no longer has."""
        if path.is_file():
            self._bucket.put(place, path.read_bytes())
            return
        sent = set()
        for each in sorted(path.rglob("*")):
            if each.is_file():
                key = f"{place}/{each.relative_to(path).as_posix()}"
                self._bucket.put(key, each.read_bytes())
                sent.add(key)
        for old in [meta.key for meta in self._bucket.list(place)]:
            if old not in sent:
                self._bucket.delete(old)

    def read_journal(self, name: str) -> bytes | None:
        """Read the journal, and remember which one it was."""
        self._journal = self._bucket.head(name)
        return None if self._journal is None else self._bucket.read_all(name)

    def write_journal(self, name: str, data: bytes) -> None:
        """Replace the journal that was read or written last.

        Raises:
            StateInUseError: If another export has written it since.
        """
        if self._bucket.head(name) != self._journal:
            raise StateInUseError(f"another export into this bucket runs ({self.url})")
        self._bucket.put(name, data)
        self._journal = self._bucket.head(name)
