"""What changes a score besides the streams: part of the pipeline version."""

import hashlib
from functools import cache
from importlib import metadata, resources
from typing import Final

LIBRARIES: Final = ("numpy", "scikit-learn", "scipy")


@cache
def contradiction_version() -> str:
    """Digest the sources of this stage, its settings among them, and the libraries it rests on.

    Returns:
        `contradiction@` and twelve hexadecimal digits.
    """
    digest = hashlib.sha256()
    for file in sorted(resources.files("workers.contradiction").iterdir(), key=lambda f: f.name):
        if file.name.endswith(".py"):
            digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    for library in LIBRARIES:
        digest.update(f"{library}=={metadata.version(library)}\n".encode())
    return f"contradiction@{digest.hexdigest()[:12]}"
