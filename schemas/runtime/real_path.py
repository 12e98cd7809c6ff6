"""Resolution of a path, also of one that leads nowhere."""

import os
from pathlib import Path


def real_path(path: Path) -> Path:
    """Return the absolute path without links, as far as they lead anywhere.

    A link to itself stays as it is: `is_symlink` is true of it, and neither `is_file` nor `is_dir`.
    `Path.resolve` raises `RuntimeError` there, which no caller expects of a name from a person.
    """
    return Path(os.path.realpath(path))
