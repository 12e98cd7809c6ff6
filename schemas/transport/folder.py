"""Listing of a folder as a bucket, which skips and reports entries that cannot be logs.

obstore's own listing of a folder fails as a whole on one bad entry. Such entries are a name that is
not UTF-8, a control character, a loop of links, or a subfolder that may not be read. Keys, sizes
and etags are the same as its own: an etag that differed would have every log of an existing state
mined again.
"""

import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Final

from schemas.bounds import MAX_TEXT
from schemas.errors import BucketRefusedError, BucketUnreachableError
from schemas.visible import has_controls, visible

_SKIPPED: Final = {
    errno.ELOOP: "is a link in a loop of links",
    errno.ENAMETOOLONG: "has a path that is longer than the system allows",
    errno.EACCES: "may not be read",
    errno.EPERM: "may not be read",
}
"""Errors that concern one entry alone; any other may mean a failing disk."""


@dataclass(frozen=True, slots=True)
class Skipped:
    """A bucket entry that is not listed.

    Attributes:
        name: Its key, control characters escaped.
        why: The end of a sentence that begins with the name.
        hides: Prefix of the keys that may lie behind it, where those cannot be known.
    """

    name: str
    why: str
    hides: str = ""

    @classmethod
    def of(cls, key: str, why: str, *, hides: str = "") -> "Skipped":
        """Make one from an unescaped key."""
        return cls(visible(key, limit=MAX_TEXT // 4), why, hides)


@dataclass(frozen=True, slots=True)
class FolderEntry:
    """A file of a folder, by the key that it has in a bucket."""

    key: str
    size: int
    etag: str


def list_folder(
    root: Path, prefix: str, on_skipped: Callable[[Skipped], None]
) -> list[FolderEntry]:
    """List the files under a folder and its subfolders, links followed, in the order of their keys.

    A file that vanishes meanwhile is left out.

    Args:
        root: Folder of the bucket.
        prefix: A subfolder, in whole path segments; empty for all.
        on_skipped: Called with each entry that cannot be a log.

    Raises:
        BucketRefusedError: If the prefix is no key, or the root may not be read.
        BucketUnreachableError: If the file system answers with an error.
    """
    inner = prefix.strip("/")
    if inner and (has_controls(inner) or {"", ".", ".."} & set(inner.split("/"))):
        raise BucketRefusedError(f"no folder of a bucket: {visible(prefix, limit=200)!r}")
    walk = _Walk(root, on_skipped)
    walk.folder(str(root / inner), f"{inner}/" if inner else "")
    return sorted(walk.found, key=lambda entry: entry.key)


def etag_of(stat: os.stat_result) -> str:
    """Return the etag that obstore gives a file: inode, time of change and size, in hexadecimal."""
    changed_us = max(stat.st_mtime_ns, 0) // 1000
    return f'"{stat.st_ino:x}-{changed_us:x}-{stat.st_size:x}"'


@dataclass(slots=True)
class _Walk:
    root: Path
    on_skipped: Callable[[Skipped], None]
    found: list[FolderEntry] = field(default_factory=list)

    def folder(self, path: str, prefix: str) -> None:
        """Collect all files below a folder; `prefix` is its key with a slash at the end."""
        waiting = [(path, prefix)]
        while waiting:
            path, prefix = waiting.pop()
            try:
                with os.scandir(path) as entries:
                    waiting.extend(
                        (entry.path, f"{prefix}{entry.name}/")
                        for entry in entries
                        if self._take(entry, prefix)
                    )
            except (FileNotFoundError, NotADirectoryError):
                continue  # it is gone, or the prefix names a file
            except OSError as error:
                self._skip(error, prefix.rstrip("/"))

    def _take(self, entry: os.DirEntry[str], prefix: str) -> bool:
        """Collect an entry if it is a file; return true if it is a folder to walk."""
        key = prefix + entry.name
        if has_controls(entry.name):
            is_utf8 = not any("\ud800" <= each <= "\udfff" for each in entry.name)
            what = "holds a control character" if is_utf8 else "is no UTF-8"
            self.on_skipped(Skipped.of(key, f"has a name that {what}"))
            return False
        try:
            if entry.is_dir(follow_symlinks=False):
                return True
            stat = entry.stat()
            if S_ISDIR(stat.st_mode):
                return self._leads_on(entry, key, stat)
        except FileNotFoundError:
            if entry.is_symlink():
                self.on_skipped(Skipped.of(key, "is a broken link"))
            return False
        except OSError as error:
            # What lies in a folder that may be read but not entered is denied one by one.
            denied = isinstance(error, PermissionError) and not entry.is_symlink()
            self._skip(error, prefix.rstrip("/") if denied else key)
            return False
        if not S_ISREG(stat.st_mode):
            self.on_skipped(Skipped.of(key, "is no file but a pipe, a socket or a device"))
        elif not _is_being_written(entry.name):
            self.found.append(FolderEntry(key, stat.st_size, etag_of(stat)))
        return False

    def _leads_on(self, entry: os.DirEntry[str], key: str, stat: os.stat_result) -> bool:
        """Return true unless a link to a folder leads back to one of its own parents."""
        above = Path(entry.path).parent
        for folder in (above, *above.parents):
            if os.path.samestat(folder.stat(), stat):
                self.on_skipped(Skipped.of(key, "is a link in a loop of links"))
                return False
            if folder == self.root:
                break
        return True

    def _skip(self, error: OSError, key: str) -> None:
        why = _SKIPPED.get(error.errno or 0)
        if why is None or not key:
            raise self._failure(error, key) from None
        hidden = error.errno in (errno.EACCES, errno.EPERM)
        self.on_skipped(Skipped.of(key, why, hides=key if hidden else ""))

    def _failure(self, error: OSError, key: str) -> BucketRefusedError | BucketUnreachableError:
        where = f"{self.root.as_uri()}{f', {visible(key, limit=1000)}' if key else ''}"
        if isinstance(error, PermissionError):
            return BucketRefusedError(f"no permission to read ({where})")
        return BucketUnreachableError(
            f"the file system answers with an error: {error.strerror} ({where})"
        )


def _is_being_written(name: str) -> bool:
    """Return true if obstore writes this file for an upload under way: `log#12`."""
    _, _, suffix = name.partition("#")
    return suffix.isascii() and suffix.isdigit()
