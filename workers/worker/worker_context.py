"""Worker context: the parts, version and open buckets that the service's settings name."""

from dataclasses import dataclass

from schemas.mining import MiningSettings
from schemas.task import MOTION
from schemas.transport.bucket import Bucket, open_bucket
from workers.errors import UnknownPartError
from workers.layers import LayerDigests
from workers.parts.protocols import Parts
from workers.version import layers_of, parts_of


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """Parts and buckets for mining, built once and used for many shards.

    Attributes:
        settings: Settings that all workers share.
        parts: Odometry and streams.
        version: Pipeline version of both.
        layers: Digests that make the version.
        bucket: The logs.
        artifacts: Bucket of the overlays.
    """

    settings: MiningSettings
    parts: Parts
    version: str
    layers: LayerDigests
    bucket: Bucket
    artifacts: Bucket


def build_context(settings: MiningSettings) -> WorkerContext:
    """Build the parts and open the buckets that the service names.

    Raises:
        PermanentError: If a part does not exist here, or has another task than motion, or a
            bucket's URL is invalid.
        TransientError: If a store does not answer.
    """
    parts = parts_of(settings)
    if parts.task != MOTION:
        raise UnknownPartError(
            f"the chosen streams answer the task {parts.task.name}, but a service ranks and counts "
            "motion alone: mine such logs with `counterpoint score`"
        )
    layers = layers_of(settings, parts)
    return WorkerContext(
        settings=settings,
        parts=parts,
        version=layers.pipeline_version,
        layers=layers,
        bucket=open_bucket(settings.bucket),
        artifacts=open_bucket(settings.artifacts, create=True),
    )
