"""A digest of source files: what a part's version says of the code its answers come from."""

import hashlib
from functools import cache
from importlib import resources


@cache
def source_digest(*packages: str) -> str:
    """Digest every Python file of these packages, names and contents, in the order of names."""
    digest = hashlib.sha256()
    for package in packages:
        for file in sorted(resources.files(package).iterdir(), key=lambda file: file.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()
