"""Part version: a digest of the code and the libraries that determine a part's output."""

import hashlib
from functools import cache
from importlib import metadata
from typing import Final

from workers.sources import syntax_digest

LIBRARIES: Final = ("kiss-icp", "numba", "numpy", "pypatchworkpp", "scikit-learn", "scipy")
PACKAGES: Final = ("workers.odometry", "workers.paper", "workers.selfsupervised")


def release(library: str) -> str:
    """Return the version of an installed library, without the `+cpu` of its build."""
    return metadata.version(library).partition("+")[0]


@cache
def version_of(name: str, settings: str = "") -> str:
    """Digest everything that determines the output of a part.

    Args:
        name: Name of the part in the registry.
        settings: The settings it was built with, as text.

    Returns:
        `name@digest`: sources, versions of the libraries, settings.
    """
    libraries = [f"{library}=={metadata.version(library)}" for library in LIBRARIES]
    facts = "\n".join([name, settings, syntax_digest(*PACKAGES), *libraries])
    return f"{name}@{hashlib.sha256(facts.encode()).hexdigest()[:12]}"
