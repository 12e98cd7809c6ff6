"""Scoring of one log on this machine, without a bus: the work of `counterpoint score`."""

from collections.abc import Callable, Iterator

from schemas.mining import MiningSettings
from schemas.score import SceneScore
from schemas.transport.bucket import Bucket
from schemas.work import Damage, Recording
from workers.errors import LogUnusableError
from workers.ingest.plan import plan_recording
from workers.mine import MinedRecord, MiningReport, mine_records
from workers.version import parts_of, pipeline_version


def score_recording(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    on_shard: Callable[[int, int], None] = lambda done, total: None,
    on_damage: Callable[[Damage], None] = lambda damage: None,
    on_scene: Callable[[MinedRecord], None] = lambda mined: None,
    on_unread_labels: Callable[[str], None] = lambda topic: None,
) -> Iterator[SceneScore]:
    """Mine a recording shard by shard, exactly as a worker would.

    Args:
        bucket: Bucket of the recording.
        recording: The log.
        settings: Grid and parts, as from a service.
        on_shard: Called with the number of shards done, and of all.
        on_damage: Called with every stretch that cannot be read.
        on_scene: Called with each scene and its overlay, before its score is yielded.
        on_unread_labels: Called with the topic of recorded labels that the settings do not use.

    Yields:
        The score of each scene, in the order of their starts within each lidar.

    Raises:
        LogUnusableError: If the log cannot be mined at all.
    """
    plan = plan_recording(bucket, recording, settings, on_unread_labels=on_unread_labels)
    if plan.refused:
        raise LogUnusableError(f"cannot mine {recording.log_id}: {plan.refused}")
    for damage in plan.damage:
        on_damage(damage)
    parts = parts_of(settings)  # takes seconds, in vain where the log cannot be mined
    version = pipeline_version(settings, parts)
    for done, shard in enumerate(plan.shards):
        on_shard(done, len(plan.shards))
        report = MiningReport()
        for mined in mine_records(
            bucket,
            recording,
            shard,
            settings=settings,
            parts=parts,
            pipeline_version=version,
            report=report,
        ):
            on_scene(mined)
            yield mined.score
        for damage in report.damage:
            on_damage(damage)
    on_shard(len(plan.shards), len(plan.shards))
