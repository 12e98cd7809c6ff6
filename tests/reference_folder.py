"""Folder of real logs, reference outputs and servers, which lies outside the project."""

import os
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent


def reference_folder() -> Path:
    """Return the folder of `COUNTERPOINT_REFERENCE`, else `shared` beside the project."""
    return Path(os.environ.get("COUNTERPOINT_REFERENCE", ROOT.parent / "shared")).resolve()
