"""Version of this stage, which changes with its scores: part of the pipeline version."""

import hashlib
from functools import cache
from importlib import metadata, resources
from typing import Final

from workers.contradiction.attribution import FILE
from workers.sources import syntax_digest

LIBRARIES: Final = ("numpy", "scikit-learn", "scipy")


@cache
def contradiction_version() -> str:
    """Digest the sources and settings of this stage, its fitted table, and its libraries.

    Returns:
        `contradiction@` and twelve hexadecimal digits.
    """
    digest = hashlib.sha256(syntax_digest("workers.contradiction").encode())
    digest.update(resources.files("workers.contradiction").joinpath(FILE).read_bytes())
    for library in LIBRARIES:
        digest.update(f"{library}=={metadata.version(library)}\n".encode())
    return f"contradiction@{digest.hexdigest()[:12]}"
