"""Object store access: listing for the service, ranged reads for the workers."""

import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

import obstore
from obstore.exceptions import BaseError, NotFoundError
from obstore.store import LocalStore, MemoryStore, ObjectStore, from_url

from schemas.errors import BucketRefusedError, BucketUnreachableError, ObjectChangedError
from schemas.runtime.real_path import real_path
from schemas.transport.bucket_errors import SUPPORTED_URLS, explain
from schemas.transport.folder import Skipped, list_folder
from schemas.visible import has_controls

if TYPE_CHECKING:
    from obstore import GetOptions

# An endpoint that is down must be named within about 20 s, a gateway that restarts (2 to 3 s) must
# go unnoticed: some seconds of retries, and no limit on the whole of a large but living transfer.
_CLIENT: Final[dict[str, Any]] = {
    "allow_http": True,  # whether the endpoint is encrypted is said by its own URL
    "connect_timeout": "4s",
    "read_timeout": "8s",
    "timeout": "10m",
}
_RETRY: Final[dict[str, Any]] = {
    "max_retries": 8,
    "retry_timeout": timedelta(seconds=10),
    "backoff": {
        "init_backoff": timedelta(milliseconds=200),
        "max_backoff": timedelta(seconds=2),
        "base": 2,
    },
}
_CONTROLS_IN_KEY: Final = "has a key that holds a control character"

_LOCAL_KEY_SEGMENTS: Final = 3
"""Path segments of a local log's key: vehicle, date and name; a path does not show its bucket."""


@dataclass(frozen=True, slots=True)
class ObjectMeta:
    """One object in the bucket, identified by key, size and etag."""

    key: str
    size: int
    etag: str


class Bucket:
    """Objects by key: listed, read by ranges, and, for artifacts only, written.

    Safe to use from several threads. Every method raises `BucketUnreachableError` when the store
    does not answer and `BucketRefusedError` when it refuses; neither ever quotes a credential.

    Attributes:
        url: Its URL, without credentials.
    """

    def __init__(self, store: ObjectStore, *, url: str, folder: Path | None = None) -> None:
        """Wrap a store; `open_bucket` is the usual way in.

        Args:
            store: Store of the objects.
            url: Its URL, without credentials.
            folder: Folder of a local store. While it does not exist the store is unreachable, since
                a disk that is not mounted must not look like an empty one.
        """
        self.url = url
        self._folder = folder
        self._store = store
        self._lock = threading.Lock()
        self._reads = 0
        self._bytes_read = 0

    def __repr__(self) -> str:
        """Show the URL only: the store behind it knows the credentials."""
        return f"Bucket({self.url!r})"

    @property
    def folder(self) -> Path | None:
        """Folder of a local store; None for any other."""
        return self._folder

    @property
    def reads(self) -> int:
        """Requests that have read objects so far."""
        return self._reads

    @property
    def bytes_read(self) -> int:
        """Bytes of objects that have been read so far."""
        return self._bytes_read

    def list(
        self,
        prefix: str = "",
        start_after: str | None = None,
        *,
        on_skipped: Callable[[Skipped], None] = lambda skipped: None,
    ) -> Iterator[ObjectMeta]:
        """Yield the objects in the order of their keys.

        Args:
            prefix: A folder, in whole path segments; empty for all.
            start_after: Only keys that come after this one.
            on_skipped: Called with each entry that is left out because it cannot be a log: a key
                with control characters; in a folder also anything but a readable regular file.
        """
        if self._folder is not None:
            yield from self._list_folder(self._folder, prefix, start_after, on_skipped)
            return
        try:
            for batch in obstore.list(self._store, prefix or None, offset=start_after):
                for meta in batch:
                    if has_controls(meta["path"]):
                        on_skipped(Skipped.of(meta["path"], _CONTROLS_IN_KEY))
                    else:
                        yield _object_meta(meta)
        except (BaseError, OSError, ValueError) as error:
            raise explain(error, url=self.url) from None

    def _list_folder(
        self,
        folder: Path,
        prefix: str,
        start_after: str | None,
        on_skipped: Callable[[Skipped], None],
    ) -> Iterator[ObjectMeta]:
        found = list_folder(folder, prefix, on_skipped)
        self._need_folder()  # what went in the middle of it lists as far as it came
        for entry in found:
            if start_after is None or entry.key > start_after:
                yield ObjectMeta(entry.key, entry.size, entry.etag)

    def head(self, key: str) -> ObjectMeta | None:
        """Return the object's size and etag; None where there is none."""
        try:
            return _object_meta(obstore.head(self._store, key))
        except (FileNotFoundError, NotFoundError):
            self._need_folder()
            return None
        except (BaseError, OSError, ValueError) as error:
            raise explain(error, url=self.url, key=key) from None

    def read_range(self, key: str, offset: int, length: int, etag: str) -> bytes:
        """Read exactly these bytes of the object that has this etag.

        Args:
            key: Which object.
            offset: First byte.
            length: Number of bytes, at least one.
            etag: The listed etag; empty where the store gives none, and then nothing is checked.

        Raises:
            ObjectChangedError: If the object was replaced, cut or deleted.
        """
        options: GetOptions = {"range": (offset, offset + length)}
        if etag:
            options["if_match"] = etag
        self._need_regular(key)
        try:
            got = obstore.get(self._store, key, options=options)
            data = got.bytes().to_bytes()
        except (BaseError, OSError, ValueError) as error:
            self._need_folder()
            raise explain(error, url=self.url, key=key) from None
        self._count(len(data))
        if len(data) != length:
            if got.meta["size"] < offset + length:
                raise ObjectChangedError(key=key)
            raise BucketUnreachableError(
                f"the store sent {len(data)} of {length} bytes; try again ({self.url}, {key})"
            )
        return data

    def read_all(self, key: str, *, at_most: int | None = None) -> bytes:
        """Read a whole object.

        Args:
            key: Which object.
            at_most: Bytes that it may have; None: any number.

        Raises:
            ObjectChangedError: If there is none.
            BucketRefusedError: If it is larger, or, in a folder, no regular file.
        """
        self._need_regular(key)
        try:
            got = obstore.get(self._store, key)
            if at_most is not None and got.meta["size"] > at_most:
                raise BucketRefusedError(
                    f"the object has {got.meta['size']} bytes, more than {at_most} ({self.url}, "
                    f"{key})"
                )
            data = got.bytes().to_bytes()
        except (BaseError, OSError, ValueError) as error:
            self._need_folder()
            raise explain(error, url=self.url, key=key) from None
        self._count(len(data))
        return data

    def put(self, key: str, data: bytes) -> None:
        """Write an object, replacing what was there. For artifacts only, never for logs."""
        try:
            obstore.put(self._store, key, data)
        except (BaseError, OSError, ValueError) as error:
            raise explain(error, url=self.url, key=key, writing=True) from None

    def put_file(self, key: str, path: Path) -> None:
        """Write an object from a file, in parts, so that memory does not grow with its size."""
        try:
            obstore.put(self._store, key, path)
        except (BaseError, OSError, ValueError) as error:
            raise explain(error, url=self.url, key=key, writing=True) from None

    def delete(self, key: str) -> None:
        """Delete an object, if there is one. For artifacts only, never for logs."""
        try:
            obstore.delete(self._store, key)
        except (BaseError, OSError, ValueError) as error:
            self._need_folder()
            if not isinstance(explain(error, url=self.url, key=key), ObjectChangedError):
                raise explain(error, url=self.url, key=key, writing=True) from None

    def _need_folder(self) -> None:
        if self._folder is not None and not self._folder.is_dir():
            raise BucketUnreachableError(f"the folder is gone; is its disk mounted? ({self.url})")

    def _need_regular(self, key: str) -> None:
        """Refuse a pipe or a device in a folder; reading it would block for ever."""
        if self._folder is None:
            return
        path = self._folder / key
        with suppress(OSError, ValueError):  # the store says itself what is missing or forbidden
            mode = path.stat().st_mode
            if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                raise BucketRefusedError(
                    f"a pipe or a device lies there, not a regular file ({path})"
                )

    def _count(self, length: int) -> None:
        with self._lock:
            self._reads += 1
            self._bytes_read += length


def open_bucket(
    url: str, *, options: Mapping[str, str] | None = None, create: bool = False
) -> Bucket:
    """Open a bucket, or a folder of one, by URL.

    Endpoint, region and credentials come from the environment as each cloud's own tools take them
    (`AWS_*`, `GOOGLE_*`, `AZURE_*`). Only local folders are checked here: another store's first
    answer comes with the first use.

    Args:
        url: `file:///folder`, a bare path, `s3://bucket/prefix`, `gs://`, `az://`, or `memory://`
            (a new, empty one each time).
        options: The same settings by obstore's names (`endpoint`, `region`, `access_key_id`, ...),
            where they do not come from the environment.
        create: Make a local folder that does not exist; for artifacts.

    Raises:
        BucketRefusedError: If the URL is of no such kind, or the folder does not exist.
    """
    parts = urlsplit(url)
    if parts.username or parts.password:
        raise BucketRefusedError(
            f"a bucket URL must not carry credentials; set them in the environment "
            f"({parts.scheme}://…{parts.path})"
        )
    if parts.scheme in ("", "file"):
        return _open_folder(Path(unquote(parts.path) if parts.scheme else url), create=create)
    if parts.scheme == "memory":
        return Bucket(MemoryStore(), url=url)
    if parts.scheme not in ("s3", "gs", "az") or not parts.netloc:
        raise BucketRefusedError(f"no bucket URL: {_plain(url)}; {SUPPORTED_URLS}")
    try:
        store = from_url(  # type: ignore[call-overload]  # one overload for each cloud's options
            url, config=dict(options or {}), client_options=_CLIENT, retry_config=_RETRY
        )
    except (BaseError, ValueError) as error:
        raise explain(error, url=_plain(url)) from None
    return Bucket(store, url=_plain(url))


def open_object(url: str, *, options: Mapping[str, str] | None = None) -> tuple[Bucket, str]:
    """Open the bucket an object lies in, and give its key there.

    Args:
        url: URL or path of one object. Of a local path the last three segments are the key.
        options: As in `open_bucket`.

    Raises:
        BucketRefusedError: If it cannot be the URL of an object.
    """
    parts = urlsplit(url)
    if parts.scheme in ("", "file"):
        path = real_path(Path(unquote(parts.path) if parts.scheme else url))
        if path.is_dir():
            raise BucketRefusedError(f"{path} is a folder; name one log in it, a file .mcap")
        if path.is_symlink():
            raise BucketRefusedError(f"this link points to itself: {path}")
        if not path.is_file():
            raise BucketRefusedError(f"no such file: {path}")
        folder = path.parents[min(_LOCAL_KEY_SEGMENTS, len(path.parents)) - 1]
        return open_bucket(str(folder)), path.relative_to(folder).as_posix()
    key = unquote(parts.path).strip("/")
    if not key:
        raise BucketRefusedError(f"the URL names a bucket, not an object in it: {_plain(url)}")
    return open_bucket(f"{parts.scheme}://{parts.netloc}", options=options), key


def _open_folder(path: Path, *, create: bool) -> Bucket:
    try:
        folder = real_path(path.expanduser())
    except RuntimeError:
        raise BucketRefusedError(
            f"the home folder of this user is not known: {path}; write the whole path"
        ) from None
    if folder.is_symlink():
        raise BucketRefusedError(f"this link points to itself: {folder}")
    if not folder.is_dir() and not create:
        problem = "is a file, not a folder" if folder.exists() else "does not exist"
        raise BucketRefusedError(f"the folder {problem}: {folder}")
    try:
        if create:
            folder.mkdir(parents=True, exist_ok=True)
        store = LocalStore(folder, automatic_cleanup=True)  # of folders that deleting has emptied
    except (BaseError, OSError) as error:
        raise explain(error, url=str(folder), writing=create) from None
    return Bucket(store, url=folder.as_uri(), folder=folder)


def _plain(url: str) -> str:
    parts = urlsplit(url)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2], query="", fragment="").geturl()


def _object_meta(meta: Any) -> ObjectMeta:
    return ObjectMeta(key=meta["path"], size=meta["size"], etag=meta["e_tag"] or "")
