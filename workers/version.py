"""The pipeline version: a digest of everything that may change a scored record."""

from typing import Final

from schemas.mining import MiningSettings
from workers.layers import Layer, LayerDigests, short_digest, source_digests
from workers.part_version import release
from workers.parts.files import PartFiles
from workers.parts.protocols import Parts
from workers.parts.registry import build_parts

NOT_IN_VERSION: Final = frozenset({"bucket", "artifacts", "model", "weights", "device", "pictures"})
"""Settings that change no record: places of logs, models and overlays, and kept pictures."""

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


def layers_of(settings: MiningSettings, parts: Parts) -> LayerDigests:
    """Digest settings, parts, sources and libraries, layer by layer.

    Settings, parts and libraries are in `labels`: which layer they change is not known.

    Args:
        settings: The service's settings that all workers share.
        parts: Odometry and streams, whose own versions digest code, weights and settings.
    """
    code = source_digests()
    labels = {
        "settings": settings.model_dump(mode="json", exclude=set(NOT_IN_VERSION)),
        "odometry": parts.odometry.version,
        "supervised": parts.supervised.version,
        "selfsupervised": parts.selfsupervised.version,
        "witness": parts.witness.version,
        "sources": code[Layer.LABELS],
        "libraries": {name: release(name) for name in LIBRARIES},
    }
    return LayerDigests(
        labels=short_digest(labels),
        contradictions=short_digest(code[Layer.CONTRADICTIONS]),
        score=short_digest(code[Layer.SCORE]),
    )


def pipeline_version(settings: MiningSettings, parts: Parts) -> str:
    """Digest all layers: equal versions promise equal records.

    Args:
        settings: The service's settings that all workers share.
        parts: Odometry and streams.

    Returns:
        Twelve hexadecimal digits; a collision within one fleet is improbable.
    """
    return layers_of(settings, parts).pipeline_version


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
    return PartFiles(
        model=settings.model,
        weights=settings.weights,
        device=settings.device,
        motion_rule=settings.motion_rule,
    )


def version_of(settings: MiningSettings) -> str:
    """Return the pipeline version of these settings, which needs their parts to be built.

    Raises:
        PermanentError: If a part does not exist here.
    """
    return pipeline_version(settings, parts_of(settings))
