"""Resolution of a path, including one whose target does not exist."""

import os
from pathlib import Path


def real_path(path: Path) -> Path:
    """Return the absolute path with links resolved as far as their targets exist.

    A link to itself is returned unchanged: `is_symlink` is true of it, and neither `is_file` nor
    `is_dir`. `Path.resolve` raises `RuntimeError` there, which no caller expects of a name that a
    user gave.
    """
    return Path(os.path.realpath(path))
