"""The folder in which the workers of one pool count, where no cleaner of `/tmp` comes."""

import fcntl
import os
import shutil
import uuid
from pathlib import Path
from typing import Final

PREFIX: Final = "worker-metrics-"
_LOCK_NAME: Final = "lock"


class MetricsFolder:
    """A folder for as long as its pool lives.

    A pool that was killed at the same moment as all of its workers leaves its folder behind. The
    next pool with the same home takes it away; a living pool is known by the lock that it holds.

    Attributes:
        path: Stays the same when the folder has to be made again.
    """

    def __init__(self, home: Path) -> None:
        """Choose a name; `hold` makes it.

        Args:
            home: Where such folders lie; made if need be. A local disk.
        """
        self._home, self._lock = home, -1
        self.path = home / f"{PREFIX}{uuid.uuid4().hex[:12]}"

    def hold(self) -> bool:
        """Make the folder unless it is there.

        Returns:
            Whether it had to be made.

        Raises:
            OSError: If it cannot be.
        """
        if self.path.is_dir():
            return False
        for left in self._home.glob(f"{PREFIX}*"):
            _remove_if_left(left)
        # Under another name until it is locked, so that no other pool takes it for left behind.
        fresh = self._home / f".{self.path.name}"
        fresh.mkdir(parents=True, exist_ok=True)
        self._let_go()
        self._lock = os.open(fresh / _LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fresh.rename(self.path)
        return True

    def remove(self) -> None:
        """Take the folder away, if it is there."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._let_go()

    def _let_go(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def _remove_if_left(folder: Path) -> None:
    """Remove a folder that no living pool holds, or leave it: that is no reason not to start."""
    try:
        lock = os.open(folder / _LOCK_NAME, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
    except OSError:  # held, or on a file system that knows no locks
        return
    finally:
        os.close(lock)
