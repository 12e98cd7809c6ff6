"""Checks of `doctor` on disks and servers: bucket, artifacts, state folder, database."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

from schemas.errors import CounterpointError
from schemas.runtime.real_path import real_path
from schemas.transport.bucket import open_bucket
from schemas.transport.folder import Skipped
from schemas.transport.recordings import group_recordings
from service.background.skipped_entries import is_wanted, skipped_among
from service.curation.status import skipped_phrases
from service.doctor.finding import Finding, ok, problem, warning
from service.errors import StateOutdatedError
from service.settings.config import Settings
from service.settings.hidden_passwords import shown
from service.store.engine import DATABASE_NAME
from service.store.file_check import check_pages, traces_of_loss
from service.store.opening import open_ledger_store_to_read
from service.store.served_bucket import served_bucket
from service.store.state import endpoint_of_running

PROBE_KEY: Final = "counterpoint-doctor-probe"
PROBE: Final = b"written by `counterpoint doctor`; may be deleted\n"

MCAP_MAGIC: Final = b"\x89MCAP0\r\n"

LITTLE_ROOM_BYTES: Final = 5_000_000_000
NO_ROOM_BYTES: Final = 100_000_000
"""Free space below which a disk counts as full, bytes. Overlays of an hour of lidar take some
gigabytes; a ledger that cannot grow stops everything.
"""

NOT_LOCAL: Final = frozenset(
    ("nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ceph", "glusterfs", "lustre", "beegfs")
) | {"virtiofs", "fuse.sshfs", "fuse.s3fs", "fuse.gcsfuse", "fuse.glusterfs", "fuse.rclone"}
"""File systems whose locks may be invisible to other machines, or ineffective."""


def bucket(settings: Settings) -> Iterator[Finding]:
    """List the logs and read the first bytes of one; nothing is written."""
    if not settings.bucket:
        yield warning("bucket", "none is named: give --bucket URL; only `worker` needs none")
        return
    store = open_bucket(settings.bucket)
    unlisted: list[Skipped] = []
    objects = list(store.list(on_skipped=unlisted.append))
    patterns = {"include": settings.include, "exclude": settings.exclude}
    recordings = group_recordings(each for each in objects if is_wanted(each.key, **patterns))
    if skipped := skipped_phrases(skipped_among(objects, unlisted, **patterns)):
        yield (warning if unlisted else ok)("bucket", f"skipped: {'; '.join(skipped)}")
    if not recordings:
        yield warning("bucket", f"lists, but no .mcap log in it counts; {_patterns(settings)}")
        return
    size = sum(part.size for each in recordings for part in each.parts)
    yield ok("bucket", f"{len(recordings)} logs, {size / 1e9:.2f} GB ({store.url})")
    first = recordings[0].parts[0]
    if first.size < len(MCAP_MAGIC):
        yield warning("bucket", f"the first log is empty: {first.key}")
        return
    head = store.read_range(first.key, 0, len(MCAP_MAGIC), first.etag)
    if head == MCAP_MAGIC:
        yield ok("bucket", f"byte ranges can be read ({first.key})")
    else:
        yield warning("bucket", f"the first log does not begin like an MCAP file: {first.key}")


def artifacts(settings: Settings) -> Iterator[Finding]:
    """Write a small object into the artifacts, and read it back."""
    url = settings.artifacts_url
    if settings.bucket and _canonical(url) == _canonical(settings.bucket):
        yield problem("artifacts", "are the log bucket itself: name another URL with --artifacts")
        return
    if not settings.artifacts and not settings.state.is_dir():
        yield ok("artifacts", f"will be made in the state folder ({shown(url)})")
        return
    store = open_bucket(url, create=True)
    deleted = False
    try:
        store.put(PROBE_KEY, PROBE)
        same = store.read_all(PROBE_KEY) == PROBE
    finally:
        with suppress(CounterpointError):  # credentials may allow writing and no deleting
            store.delete(PROBE_KEY)
            deleted = True
    left = "" if deleted else f"; the probe {PROBE_KEY} remains, since it cannot be deleted"
    if same:
        yield ok("artifacts", f"can be written and read ({store.url}){left}")
    else:
        yield problem(
            "artifacts", f"what was written does not read back the same ({store.url}){left}"
        )


def state(settings: Settings) -> Iterator[Finding]:
    """Check that the state folder is writable, local and not full, and find its user process."""
    folder = settings.state.absolute()
    exists = folder.is_dir()
    at = folder if exists else next(up for up in folder.parents if up.is_dir())
    try:
        with tempfile.TemporaryFile(dir=at):
            pass
    except OSError as error:
        yield problem("state", f"cannot be written: {error.strerror}; fix its permissions ({at})")
        return
    yield ok("state", f"can be written ({folder})" if exists else f"will be made ({folder})")
    free = shutil.disk_usage(at).free
    room = f"{free / 1e9:.1f} GB free ({at})"
    if free < NO_ROOM_BYTES:
        yield problem("state", f"{room}: make room, or name another folder with --state")
    elif free < LITTLE_ROOM_BYTES:
        yield warning("state", f"{room}: overlays of an hour of lidar take some GB")
    else:
        yield ok("state", room)
    kind = file_system_of(at)
    if kind in NOT_LOCAL:
        yield problem(
            "state",
            f"lies on {kind}, where locks of other machines may be invisible: use a local disk"
            + ("" if settings.database else ", or a PostgreSQL with --database"),
        )
    endpoint = endpoint_of_running(folder)
    if endpoint is None:
        yield ok("state", "no service holds it")
    else:
        yield ok("state", f"a service holds it{f', at {endpoint}' if endpoint else ''}")


def database(settings: Settings) -> Iterator[Finding]:
    """Open the database for reading, and check every page of a SQLite file of any size.

    The check at a start skips the scenes of a very large one. 4.4 GB take 7 s from memory, 54 s
    from disk.
    """
    path = settings.state / DATABASE_NAME
    where = shown(settings.database) if settings.database else str(path)
    if not settings.database and (loss := traces_of_loss(path)):
        yield warning("database", loss)
        return
    if not settings.database and not path.is_file():
        yield ok("database", f"none yet: the first run makes it ({path})")
        return
    try:
        with closing(open_ledger_store_to_read(settings)) as store, store.reading() as connection:
            served = served_bucket(connection)
            if not settings.database:
                check_pages(connection, path, whole=True)
    except StateOutdatedError as error:
        yield warning("database", str(error))
        return
    yield ok("database", f"can be read, and is of this version ({where})")
    if settings.bucket and served and open_bucket(settings.bucket).url != served:
        yield warning(
            "database",
            f"belongs to {served}: a run on another bucket is refused, unless that has its logs; "
            "name another folder with --state",
        )


def file_system_of(folder: Path, mounts: Path = Path("/proc/self/mountinfo")) -> str:
    """Return the type of file system of a folder; empty where the system does not report it."""
    if not mounts.is_file():
        return ""
    resolved, kinds = real_path(folder), {}
    for line in mounts.read_text(encoding="utf-8").splitlines():
        before, _, after = line.partition(" - ")
        point = Path(before.split()[4].encode().decode("unicode_escape"))
        if resolved.is_relative_to(point):
            kinds[len(point.parts)] = after.split()[0]
    return kinds[max(kinds)] if kinds else ""


def _patterns(settings: Settings) -> str:
    include, exclude = shown(settings.include), shown(settings.exclude)
    return f"include: {include or 'all'}, exclude: {exclude or 'none'}"


def _canonical(url: str) -> str:
    return (url if "://" in url else real_path(Path(url)).as_uri()).rstrip("/")
