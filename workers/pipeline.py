"""Mining pipeline, the method of Counterpoint. Start reading here."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import tee

from schemas.contradiction import Instance, LabelledFrame, Scene
from schemas.frame import LidarFrame
from schemas.score import SceneScore, is_taught
from schemas.work import Shard
from workers.contradiction.agreement import compare
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.feature_extraction import extract_features
from workers.contradiction.instances import find_instances
from workers.contradiction.scene_statistics import statistics_of
from workers.contradiction.score import score_scene
from workers.contradiction.scoring_inputs import ScoringInputs, inputs_of
from workers.contradiction.track_score import RankedTrack, rank_tracks
from workers.contradiction.tracks import associate_instances
from workers.ingest.scenes import cut_scenes
from workers.lidar.several_lidars import posed_frames
from workers.parts.lidar_by_lidar import labels_of_lidars
from workers.parts.protocols import Parts


@dataclass(frozen=True, slots=True, eq=False)
class MinedScene:
    """A scored scene with the points, instances, tracks and scoring inputs of its overlay."""

    score: SceneScore
    scene: Scene
    instances: tuple[Instance, ...]
    tracks: tuple[RankedTrack, ...]
    inputs: ScoringInputs


def mine_shard(
    shard: Shard, frames: Iterable[LidarFrame], parts: Parts, *, pipeline_version: str
) -> Iterator[MinedScene]:
    """Score every scene of one shard by the contradictions of its two streams.

    Both streams process the shard's frames once, warm-up included, because odometry, residual
    images and free space have state. The witness receives the labels of both streams, and sees one
    second further. Only scenes inside the window are scored. Frames are processed one by one, so
    memory contains a scene and not a shard.

    Apart from the parts the function is pure: it uses no file, socket or clock. A test can mine a
    synthetic street, and the pool can retry safely.

    Frames of several lidars have the poses of the main one. Networks label the cloud of each lidar
    for itself; all else is judged about the points of all of them.
    """
    posed, for_supervised, for_selfsupervised = tee(posed_frames(frames, parts.odometry), 3)
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
            labels_of_lidars(parts.supervised, for_supervised),
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
        attributions = attribute_tracks(described, taught=is_taught(parts.supervised.version))
        ranked = rank_tracks(scene, described, attributions)
        statistics = statistics_of(scene)
        score = score_scene(
            *(shard, scene, instances, ranked),
            parts=parts,
            pipeline_version=pipeline_version,
            statistics=statistics,
        )
        inputs = inputs_of(
            *(score, scene, instances, described, statistics), own_model=parts.own_model
        )
        yield MinedScene(score, scene, instances, ranked, inputs)
