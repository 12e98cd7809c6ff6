"""Whoever drops logs in a bucket, a folder or on S3, and takes the store behind it away."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import obstore
from obstore.store import ObjectStore

from schemas.transport.bucket import Bucket, open_bucket
from tests.integration.object_store import Ceph

AWAY_S = 1.5
"""How long a store is away: some listings, and some reads that are under way."""


class Hand(Protocol):
    """Changes a bucket, and takes it away.

    Attributes:
        url: Of the bucket.
        can_litter: Whether something other than objects can lie in it.
    """

    url: str
    can_litter: bool

    def open(self) -> Bucket:
        """Open the bucket as the product does."""
        ...

    def put(self, key: str, data: bytes) -> None:
        """Let an object hold this from now on."""
        ...

    def delete(self, key: str) -> None:
        """Remove it."""
        ...

    def litter(self) -> None:
        """Leave entries in it that are no logs, and that nobody can read."""
        ...

    def take_store_away(self, say: Callable[[str], None]) -> None:
        """Take the store away, say how, and bring it back after a while."""
        ...


class FolderHand:
    """Writes files as a recorder does: in place, piece by piece."""

    can_litter = True

    def __init__(self, folder: Path) -> None:
        self._folder, self.url = folder, str(folder)
        self._leaves_folder = False
        folder.mkdir(parents=True, exist_ok=True)

    def open(self) -> Bucket:
        return open_bucket(self.url)

    def put(self, key: str, data: bytes) -> None:
        """Append or cut where one is a beginning of the other, else put another file there."""
        path = self._folder / key
        path.parent.mkdir(parents=True, exist_ok=True)
        there = path.read_bytes() if path.exists() else b""
        if there and (data.startswith(there) or there.startswith(data)):
            with path.open("r+b") as file:
                file.truncate(min(len(there), len(data)))
                file.seek(0, 2)
                file.write(data[len(there) :])
            return
        new = path.with_suffix(".new")
        new.write_bytes(data)
        new.replace(path)

    def delete(self, key: str) -> None:
        (self._folder / key).unlink()

    def litter(self) -> None:
        """Leave names that are no text, links that lead nowhere, a pipe and a closed folder."""
        folder = self._folder / "car-3" / "odd"
        (folder / "closed").mkdir(parents=True)
        for name in (b"not\xffutf8.mcap", b"new\nline.mcap", b"tab\t.mcap", b"esc\x1b[31m.mcap"):
            Path(os.fsdecode(os.fsencode(folder) + b"/" + name)).write_bytes(b"no recording")
        (folder / "again").symlink_to("..")
        (folder / "one.mcap").symlink_to("other.mcap")
        (folder / "other.mcap").symlink_to("one.mcap")
        (folder / "dangling.mcap").symlink_to("nowhere.mcap")
        os.mkfifo(folder / "pipe.mcap")
        (folder / "folder.mcap").mkdir()
        (folder / "closed" / "drive.mcap").write_bytes(b"no recording")
        (folder / "closed").chmod(0)

    def take_store_away(self, say: Callable[[str], None]) -> None:
        """Every other time leave an empty folder, as a disk does that is not mounted."""
        say("the disk" + (", whose mount point lies empty now" if self._leaves_folder else ""))
        away = self._folder.with_name(f"{self._folder.name}-away")
        self._folder.rename(away)
        if self._leaves_folder:
            self._folder.mkdir()
        time.sleep(AWAY_S)
        if self._leaves_folder:
            self._folder.rmdir()
        away.rename(self._folder)
        self._leaves_folder = not self._leaves_folder


class S3Hand:
    """Uploads objects, whole each time, as S3 wants it."""

    can_litter = False

    def __init__(self, ceph: Ceph) -> None:
        self._ceph, self._name = ceph, ceph.make_bucket()
        self._store: ObjectStore = ceph.store(self._name)
        self.url = f"s3://{self._name}"

    def open(self) -> Bucket:
        return self._ceph.open(self._name)

    def put(self, key: str, data: bytes) -> None:
        obstore.put(self._store, key, data)

    def delete(self, key: str) -> None:
        obstore.delete(self._store, key)

    def litter(self) -> None:
        raise AssertionError("a bucket on S3 holds nothing but objects")

    def take_store_away(self, say: Callable[[str], None]) -> None:
        say("the gateway")
        self._ceph.kill()
        time.sleep(AWAY_S)
        self._ceph.start()
