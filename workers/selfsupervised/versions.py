"""The version of a part: a digest of the code and the libraries that its answers come from."""

import hashlib
from functools import cache
from importlib import metadata, resources
from typing import Final

LIBRARIES: Final = ("kiss-icp", "numba", "numpy", "pypatchworkpp", "scikit-learn", "scipy")
PACKAGES: Final = ("workers.geometry", "workers.selfsupervised")


@cache
def source_digest() -> str:
    """Digest of every source file that the self-supervised stream is made of."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted(resources.files(package).iterdir(), key=lambda file: file.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


@cache
def version_of(name: str, settings: str = "") -> str:
    """Name a part by all that changes its output.

    Args:
        name: What the part is called in the registry.
        settings: The settings it was built with, as text.

    Returns:
        `name@digest`: sources, versions of the libraries, settings.
    """
    libraries = [f"{library}=={metadata.version(library)}" for library in LIBRARIES]
    said = "\n".join([name, settings, source_digest(), *libraries])
    return f"{name}@{hashlib.sha256(said.encode()).hexdigest()[:12]}"
