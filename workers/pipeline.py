"""The method itself. Read this first."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import tee

from schemas.contradiction import Instance, LabelledFrame, Scene
from schemas.frame import LidarFrame
from schemas.score import SceneScore
from schemas.work import Shard
from workers.contradiction.agreement import compare
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.feature_extraction import extract_features
from workers.contradiction.instances import find_instances
from workers.contradiction.score import score_scene
from workers.contradiction.track_score import RankedTrack, rank_tracks
from workers.contradiction.tracks import associate_instances
from workers.ingest.scenes import cut_scenes
from workers.parts.protocols import Parts


@dataclass(frozen=True, slots=True, eq=False)
class MinedScene:
    """A scored scene, with the points, instances and tracks that its overlay is made of."""

    score: SceneScore
    scene: Scene
    instances: tuple[Instance, ...]
    tracks: tuple[RankedTrack, ...]


def mine_shard(
    shard: Shard, frames: Iterable[LidarFrame], parts: Parts, *, pipeline_version: str
) -> Iterator[MinedScene]:
    """Score every scene of one shard by how much the two streams contradict each other.

    Both streams see the shard's frames once, warm-up included, because odometry, residual images
    and free space remember; the witness sees what both said, and a second more. Only scenes inside
    the window are scored. Frames flow through one by one, so memory holds a scene, not a shard.
    Pure but for the parts: no file, no socket, no clock, so a test mines a synthetic street and the
    pool retries safely.
    """
    posed, for_supervised, for_selfsupervised = tee(parts.odometry(frames), 3)
    task = parts.task
    labelled = (
        LabelledFrame(
            frame,
            semantic,
            predictive,
            compare(semantic.labels, predictive.labels, task),
            task,
        )
        for frame, semantic, predictive in zip(
            posed,
            parts.supervised(for_supervised),
            parts.selfsupervised(for_selfsupervised),
            strict=True,
        )
    )
    for scene in cut_scenes(shard, parts.witness(labelled)):
        instances = find_instances(
            scene, class_names=parts.supervised.class_names, settings=parts.instances
        )
        tracks = associate_instances(scene, instances)
        described = extract_features(scene, instances, tracks)
        attributions = attribute_tracks(described)
        ranked = rank_tracks(scene, described, attributions)
        score = score_scene(
            shard, scene, instances, ranked, parts=parts, pipeline_version=pipeline_version
        )
        yield MinedScene(score, scene, instances, ranked)
