"""Who was really wrong about each track: what attribution is fitted on."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Wrong
from schemas.bucket import Bucket
from schemas.mining import MiningSettings
from schemas.work import Recording
from workers.contradiction.strength import rank_tracks
from workers.evaluation.failures.mine_log import planted_beside, slips_in
from workers.evaluation.failures.seen import SeenFrame
from workers.evaluation.failures.slips import SlippingOdometry
from workers.evaluation.failures.verdicts import thing_under, verdict_of
from workers.evaluation.truth import LogTruth
from workers.evaluation.whole_log import shards_of_log
from workers.ingest.read import read_shard
from workers.pipeline import MinedScene, mine_shard
from workers.version import parts_of


class TrackRow(BaseModel):
    """One contradicting track with what is known about it, and who was wrong."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log_id: str
    scene_id: str
    kind: str
    evidence: dict[str, float]
    frames: int
    points: int = Field(description="Over all frames.")
    strength: float = Field(description="Before the odometry gate.")
    said: Wrong | None = Field(description="Who the record says is wrong.")
    wrong: Wrong = Field(description="Who was, about the thing that the track lies on.")


def rows_of_log(
    bucket: Bucket, recording: Recording, settings: MiningSettings, *, truth: Path
) -> Iterator[TrackRow]:
    """Mine a log, what slips in it included, and judge its tracks; nothing where it has no truth.

    Args:
        bucket: Where it lies.
        recording: The log.
        settings: How it is mined.
        truth: Folder of the truth of the bucket.
    """
    found = LogTruth.beside(recording, truth)
    if found is None:
        return
    parts = parts_of(settings)
    slips = slips_in(planted_beside(recording, truth))
    if slips:
        parts = replace(parts, odometry=SlippingOdometry(parts.odometry, slips))
    read = 0
    for shard in shards_of_log(bucket, recording, settings, topic=found.topic):
        frames = read_shard(bucket, recording, shard, settings).frames()
        for mined in mine_shard(shard, frames, parts, pipeline_version=""):
            seen = []
            for labelled in mined.scene.frames:
                number = found.number_of(labelled.posed.frame, position=read)
                seen.append(SeenFrame(labelled, found.of(labelled.posed.frame, number=number)))
                read += 1
            yield from rows_of(mined, seen)


def rows_of(mined: MinedScene, seen: Sequence[SeenFrame]) -> Iterator[TrackRow]:
    """Judge the tracks of a scene; those of which truth knows less than half are left out."""
    for ranked in rank_tracks(mined.scene, mined.instances):
        members = [mined.instances[member] for member in ranked.track.members]
        _, thing = thing_under(members, seen, ())
        verdict = verdict_of(members, seen, track=thing)
        if verdict is None:
            continue
        yield TrackRow(
            log_id=mined.score.log_id,
            scene_id=mined.scene.scene_id,
            kind=ranked.track.kind.name,
            evidence=ranked.evidence.named(),
            frames=len(members),
            points=ranked.points,
            strength=ranked.strength,
            said=None if ranked.attribution is None else ranked.attribution.wrong,
            wrong=verdict,
        )
