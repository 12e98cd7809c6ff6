"""State folder: its lock for one service at a time, which any process may query."""

import fcntl
import json
import os
import shutil
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from service.errors import StateInUseError, StateUnusableError

LOCK_NAME: Final = "service.lock"
_PATIENCE_S: Final = 0.5
"""Time to retry the lock, seconds; `endpoint_of_running` holds it for an instant."""


def prepare_state(folder: Path) -> None:
    """Make the folder if it is missing, and check that files can be made in it.

    Raises:
        StateUnusableError: If it cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (FileExistsError, NotADirectoryError) as error:
        raise StateUnusableError(
            f"cannot write the state folder: this is a file, or has one in its way ({folder}); "
            "name a folder with --state"
        ) from error
    except OSError as error:
        raise StateUnusableError(
            f"cannot write the state folder: {error.strerror} ({folder}); "
            "fix its permissions or name another with --state"
        ) from error


def free_bytes(folder: Path) -> int | None:
    """Return the free bytes on the disk of a folder; None if it cannot be queried now."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


class StateLock:
    """Exclusive right to write a state folder, for the life of the process at most.

    It is a kernel lock on an open file, which cannot outlive its process. It works only on local
    file systems, like SQLite's own locks.
    """

    def __init__(self, folder: Path, *, endpoint: str = "") -> None:
        """Take the lock; `announce` the endpoint later if it is not known yet.

        Raises:
            StateInUseError: If another process holds it; the message names its endpoint.
            StateUnusableError: If the lock file cannot be written.
        """
        self._folder = folder
        try:
            self._file = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise StateUnusableError(
                f"cannot write the state folder: {error.strerror} ({folder})"
            ) from error
        if not _locked(self._file, fcntl.LOCK_EX, patience_s=_PATIENCE_S):
            holder = _holder(self._file)
            os.close(self._file)
            raise StateInUseError(_in_use(folder, holder))
        self.announce(endpoint)

    def announce(self, endpoint: str) -> None:
        """Write the endpoint of this service into the lock file; empty: not yet known."""
        content = json.dumps({"pid": os.getpid(), "endpoint": endpoint}).encode()
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, content, 0)

    def release(self) -> None:
        """Release the lock; the file stays, since removing it would race with the next service."""
        if self._file >= 0:
            os.ftruncate(self._file, 0)
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


def endpoint_of_running(folder: Path) -> str | None:
    """Return the endpoint of the service that holds this folder.

    Returns:
        Its endpoint; "" when it runs but has not announced one yet; None when no service runs.
    """
    try:
        file = os.open(folder / LOCK_NAME, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None  # no folder, no lock file, or not ours to read: no process to name
    try:
        if _locked(file, fcntl.LOCK_SH, patience_s=0.0):
            return None
        return _holder(file)[1]
    finally:
        os.close(file)


def _locked(file: int, kind: int, *, patience_s: float) -> bool:
    end_s = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= end_s:
                return False
            time.sleep(0.02)
        else:
            return True


def _holder(file: int) -> tuple[int, str]:
    """Return process id and endpoint; 0 and "" while the holder is just writing them."""
    try:
        content = json.loads(os.pread(file, 65_536, 0))
        return int(content["pid"]), str(content["endpoint"])
    except (ValueError, KeyError, TypeError):
        return 0, ""


def _in_use(folder: Path, holder: tuple[int, str]) -> str:
    pid, endpoint = holder
    who = f"process {pid}" if pid else "another process"
    if not endpoint:
        return f"a service already holds this state: {who} ({folder})"
    return (
        f"a service already holds this state: {who} at {endpoint} ({folder}); --connect {endpoint}"
    )
