"""A small disk for the database, which a run of chaos fills."""

import os
import subprocess
from pathlib import Path
from typing import Final

DISK_MB: Final = 160
"""Size of the disk of the database, where a file system may be mounted."""


def mount(point: Path) -> bool:
    """Mount a small file system in memory; return false if that is not allowed."""
    if os.geteuid() != 0:
        return False
    size = f"size={DISK_MB}m"
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "none", point], capture_output=True)
    return done.returncode == 0


def unmount(point: Path) -> None:
    """Unmount it, even if it is in use."""
    subprocess.run(["umount", "--lazy", point], check=True)


def fill(folder: Path) -> None:
    """Write until the disk of a folder is full."""
    with (folder / _FILLER).open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(1 << 20))
        except OSError:
            return


def empty(folder: Path) -> None:
    """Delete what filled the disk."""
    (folder / _FILLER).unlink(missing_ok=True)


_FILLER: Final = "filler"
