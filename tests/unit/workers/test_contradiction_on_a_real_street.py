from pathlib import Path

import numpy as np
import pytest

from schemas.contradiction import ContradictionKind, LabelledFrame, Scene
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.task import MOTION
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.labelled_worlds import ranked_tracks, shard_of
from workers.contradiction.agreement import compare
from workers.contradiction.instances import find_instances
from workers.contradiction.score import score_scene
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.parts.protocols import Parts

LOG = "pandaset/panda-01/2019-05-11/pandaset-002"
HIDDEN_MOVER, PARKED_CAR = 67, 1
FRAMES = 8


class _Truth:
    """Stands for a stream: only its version is asked for."""

    version = "truth@000000000000"
    task = MOTION
    class_names: tuple[str, ...] = ()


@pytest.fixture(scope="module")
def street(reference: Path) -> Scene:
    """Real frames; the supervised stream is truth but for a mover it misses and a phantom."""
    bucket_url = (reference / "data" / "logs").as_uri()
    settings = MiningSettings(bucket=bucket_url, artifacts="memory://")
    bucket = open_bucket(bucket_url)
    (recording,) = group_recordings(bucket.list(prefix=LOG.rpartition("/")[0]))
    shard = plan_recording(bucket, recording, settings).shards[0]
    truth = reference / "data" / "truth" / LOG
    poses = np.load(truth / "poses.npz")["world_from_lidar_at_stamp"]
    labelled = []
    for index, frame in enumerate(read_shard(bucket, recording, shard, settings).frames()):
        if index == FRAMES:
            break
        known = np.load(truth / f"{index:06d}.npz")
        of_motion = np.array(
            [MotionLabel.UNKNOWN, MotionLabel.STATIC, MotionLabel.DYNAMIC], dtype=np.uint8
        )
        predictive = of_motion[known["motion"]]
        semantic = predictive.copy()
        semantic[known["track"] == HIDDEN_MOVER] = MotionLabel.STATIC
        semantic[known["track"] == PARKED_CAR] = MotionLabel.DYNAMIC
        sure = np.full(len(frame), 0.9, dtype=np.float16)
        labelled.append(
            LabelledFrame(
                PosedFrame(frame, np.linalg.inv(poses[0]) @ poses[index]),
                FrameLabels(semantic, sure),
                FrameLabels(predictive, sure, ground_mask=known["ground"] == 1),
                compare(semantic, predictive),
            )
        )
    return Scene(f"{LOG}/lidar.top.points/{labelled[0].stamp_ns}", tuple(labelled))


@pytest.mark.reference
def test_the_missed_mover_and_the_phantom_are_the_only_tracks_of_a_real_street(
    street: Scene, reference: Path
) -> None:
    instances = find_instances(street, class_names=())
    record = score_scene(
        shard_of(LOG),
        street,
        instances,
        ranked_tracks(street, instances),
        parts=Parts(odometry=_Truth(), supervised=_Truth(), selfsupervised=_Truth()),  # type: ignore[arg-type]
        pipeline_version="truth",
    )
    kinds = {track.kind: track for track in record.tracks if track.strength > 0.05}
    assert set(kinds) == {
        ContradictionKind.ONLY_PREDICTIVE_DYNAMIC,
        ContradictionKind.ONLY_SEMANTIC_DYNAMIC,
    }
    for kind, track_id in (
        (ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, HIDDEN_MOVER),
        (ContradictionKind.ONLY_SEMANTIC_DYNAMIC, PARKED_CAR),
    ):
        track = kinds[kind]
        assert track.frames == FRAMES
        assert 3.0 < track.strongest.size_m[0] < 5.5
        for instance in instances:
            if instance.kind.name == kind and len(instance.point_index) > 100:
                known = np.load(
                    reference / "data" / "truth" / LOG / f"{instance.frame_index:06d}.npz"
                )
                assert (known["track"][instance.point_index] == track_id).all()
