"""Plan of a whole log as one shard, so that streams keep their state from the first frame."""

from typing import Final

from schemas.mining import Grid, MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import LogPlan, Recording, Shard
from workers.errors import LogUnusableError
from workers.ingest.plan import plan_recording

LONGEST_SHARD_S: Final = 3600.0
"""Longest shard that a grid allows, seconds; longer logs have several shards with a warm-up each.
"""


def shards_of_log(
    bucket: Bucket, recording: Recording, settings: MiningSettings, *, topic: str = ""
) -> list[Shard]:
    """Plan a log as mining does, in one shard of one lidar; raises as `plan_of_log` does."""
    plan = plan_of_log(bucket, recording, settings, topic=topic)
    return [shard for shard in plan.shards if shard.lidar.topic == plan.lidar_topics[0]]


def plan_of_log(
    bucket: Bucket, recording: Recording, settings: MiningSettings, *, topic: str = ""
) -> LogPlan:
    """Plan a log as mining does, but in one shard for each lidar.

    Args:
        bucket: Bucket of the recording.
        recording: The log.
        settings: Grid, ingest settings and lidar topic.
        topic: Lidar topic; empty for that of the settings, or the first by evidence.

    Raises:
        LogUnusableError: If the log cannot be mined.
    """
    scene_s = settings.grid.scene_s
    grid = settings.grid.model_copy(update={"shard_s": LONGEST_SHARD_S // scene_s * scene_s})
    chosen = {"lidar_topic": topic} if topic else {}
    plan = plan_recording(
        bucket,
        recording,
        settings.model_copy(update={"grid": Grid.model_validate(grid.model_dump()), **chosen}),
    )
    if plan.refused:
        raise LogUnusableError(f"cannot read {recording.log_id}: {plan.refused}")
    return plan
