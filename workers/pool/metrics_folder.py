"""Folder of a pool's metrics files, outside of `/tmp` and its cleaners."""

import fcntl
import os
import shutil
import uuid
from pathlib import Path
from typing import Final

PREFIX: Final = "worker-metrics-"
_LOCK_NAME: Final = "lock"


class MetricsFolder:
    """A folder with the lifetime of its pool.

    A pool that was killed at the same moment as all of its workers leaves its folder behind. The
    next pool with the same home removes it; a living pool is recognised by its lock.

    Attributes:
        path: Path of the folder; it stays the same when the folder is created again.
    """

    def __init__(self, home: Path) -> None:
        """Choose a name; `hold` creates the folder.

        Args:
            home: Parent of such folders on a local disk; created if needed.
        """
        self._home, self._lock = home, -1
        self.path = home / f"{PREFIX}{uuid.uuid4().hex[:12]}"

    def hold(self) -> bool:
        """Create and lock the folder unless it exists.

        Returns:
            Whether it was created.

        Raises:
            OSError: If it cannot be created.
        """
        if self.path.is_dir():
            return False
        for left in self._home.glob(f"{PREFIX}*"):
            _remove_if_left(left)
        # Under another name until it is locked, so that no other pool removes it as left behind.
        fresh = self._home / f".{self.path.name}"
        fresh.mkdir(parents=True, exist_ok=True)
        self._let_go()
        self._lock = os.open(fresh / _LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fresh.rename(self.path)
        return True

    def remove(self) -> None:
        """Remove the folder, if it exists."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._let_go()

    def _let_go(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def _remove_if_left(folder: Path) -> None:
    """Remove a folder without a living pool; a failure is ignored, so that the pool can start."""
    try:
        lock = os.open(folder / _LOCK_NAME, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
    except OSError:  # held, or on a file system without locks
        return
    finally:
        os.close(lock)
