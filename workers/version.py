"""The pipeline version: a digest of everything that may change a scored record."""

import hashlib
from importlib.metadata import version
from typing import Final

from schemas.mining import MiningSettings
from schemas.wire import canonical_json
from workers.contradiction.version import contradiction_version
from workers.part_files import PartFiles
from workers.protocols import Parts
from workers.registry import build_parts

NOT_IN_VERSION: Final = frozenset({"bucket", "artifacts", "model", "weights"})
"""Where logs and models lie and overlays go changes no record; every other setting may."""


def pipeline_version(settings: MiningSettings, parts: Parts) -> str:
    """Digest grid, settings, parts and the package: equal versions promise equal bytes.

    Args:
        settings: What the service says every worker must do alike.
        parts: Odometry and streams, whose own versions digest code, weights and settings.

    Returns:
        Twelve hexadecimal digits; two pipelines of one fleet never meet by chance.
    """
    facts = {
        "settings": settings.model_dump(mode="json", exclude=set(NOT_IN_VERSION)),
        "odometry": parts.odometry.version,
        "supervised": parts.supervised.version,
        "selfsupervised": parts.selfsupervised.version,
        "witness": parts.witness.version,
        "contradiction": contradiction_version(),
        "package": version("counterpoint"),
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
    """Say which files the settings name."""
    return PartFiles(model=settings.model, weights=settings.weights)


def version_of(settings: MiningSettings) -> str:
    """Return the pipeline version of these settings, building the parts to ask them for theirs.

    Raises:
        PermanentError: If a part does not exist here.
    """
    return pipeline_version(settings, parts_of(settings))
