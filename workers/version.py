"""The pipeline version: a digest of everything that may change a scored record."""

import hashlib
from typing import Final

from schemas.canonical import canonical_json
from schemas.mining import MiningSettings
from workers.contradiction.version import contradiction_version
from workers.part_version import release
from workers.parts.files import PartFiles
from workers.parts.protocols import Parts
from workers.parts.registry import build_parts
from workers.sources import syntax_digest

NOT_IN_VERSION: Final = frozenset({"bucket", "artifacts", "model", "weights", "pictures"})
"""Settings that change no record: places of logs, models and overlays, and kept pictures."""

ROOTS: Final = ("workers.ingest.plan", "workers.mine", "workers.parts.registry")
"""Modules that plan and mine a log; with all their imports they are the code of a record."""

LIBRARIES: Final = (
    "kiss-icp",
    "mcap",
    "mcap-protobuf-support",
    "mcap-ros1-support",
    "mcap-ros2-support",
    "numba",
    "numpy",
    "pypatchworkpp",
    "scikit-learn",
    "scipy",
    "torch",
)
"""Distributions that the values of a record may depend on."""


def pipeline_version(settings: MiningSettings, parts: Parts) -> str:
    """Digest settings, parts, sources and libraries: equal versions promise equal records.

    Args:
        settings: The service's settings that all workers share.
        parts: Odometry and streams, whose own versions digest code, weights and settings.

    Returns:
        Twelve hexadecimal digits; a collision within one fleet is improbable.
    """
    facts = {
        "settings": settings.model_dump(mode="json", exclude=set(NOT_IN_VERSION)),
        "odometry": parts.odometry.version,
        "supervised": parts.supervised.version,
        "selfsupervised": parts.selfsupervised.version,
        "witness": parts.witness.version,
        "contradiction": contradiction_version(),
        "sources": syntax_digest(*ROOTS),
        "libraries": {name: release(name) for name in LIBRARIES},
    }
    return hashlib.sha256(canonical_json(facts)).hexdigest()[:12]


def parts_of(settings: MiningSettings) -> Parts:
    """Build the parts that these settings name.

    Raises:
        PermanentError: If one does not exist here, or its weights cannot be loaded.
    """
    return build_parts(
        odometry=settings.odometry,
        supervised=settings.supervised,
        selfsupervised=settings.selfsupervised,
        witness=settings.witness,
        instances=settings.instances,
        files=files_of(settings),
    )


def files_of(settings: MiningSettings) -> PartFiles:
    """Return the files that the settings name."""
    return PartFiles(model=settings.model, weights=settings.weights)


def version_of(settings: MiningSettings) -> str:
    """Return the pipeline version of these settings, which needs their parts to be built.

    Raises:
        PermanentError: If a part does not exist here.
    """
    return pipeline_version(settings, parts_of(settings))
