"""Builders of the things that travel, for tests of any part: everything not asked for is plain."""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import (
    ContradictionKind,
    InstanceRecord,
    LabelledFrame,
    Scene,
    SceneState,
    TrackRecord,
)
from schemas.frame import LidarFrame, OdometryState, PosedFrame, RecordedLabels
from schemas.labels import FrameLabels
from schemas.score import AgreementShares, KindTotal, OdometryHealth, Producers, Reason, SceneScore
from workers.contradiction.agreement import compare
from workers.lab.simulation.faults.fault_truth import PlantedFaults
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.output.write import Identity, RecordedAs, write_log
from workers.lab.simulation.sensor.lidar import UNIFORM_64, Lidar
from workers.lab.simulation.sensor.sensors import further_lidars
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import EgoStyle

BEGIN_NS = 1_772_445_600 * NS_PER_S
LOG_ID = "car-7/2026-03-02/drive"
FRAME_STEP_NS = 100_000_000

SMALL_LIDAR = Lidar(elevation_deg=UNIFORM_64[::4], columns=128)
"""Sixteen beams, 128 columns: 2,000 points a frame, written in a millisecond or two."""


def frame(points_m: ArrayLike, *, at_s: float = 0.0, **changes: Any) -> LidarFrame:
    """Make a frame of these points; all valid, fired at once, without ring."""
    points = np.array(points_m, dtype=np.float32).reshape(-1, 3)
    n = len(points)
    fields: dict[str, Any] = {
        "log_id": LOG_ID,
        "stamp_ns": BEGIN_NS + round(at_s * NS_PER_S),
        "points_m": points,
        "intensity": np.zeros(n, dtype=np.float32),
        "offset_ns": np.zeros(n, dtype=np.int32),
        "ring": np.full(n, -1, dtype=np.int16),
        "valid_mask": np.ones(n, dtype=np.bool_),
    }
    return LidarFrame(**(fields | changes))


def pose(x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> NDArray[np.float64]:
    """Make `odom_from_sensor` of a sensor that moves in the plane."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    odom_from_sensor = np.eye(4)
    odom_from_sensor[:2, :2] = [[cos, -sin], [sin, cos]]
    odom_from_sensor[:2, 3] = x_m, y_m
    return odom_from_sensor


def posed(
    lidar_frame: LidarFrame,
    odom_from_sensor: NDArray[np.float64] | None = None,
    *,
    odometry: OdometryState = OdometryState.HEALTHY,
    static_residual_m: float = 0.05,
    reason: str = "",
) -> PosedFrame:
    """Give a frame its pose; the origin of odom space when none is given."""
    where = pose() if odom_from_sensor is None else odom_from_sensor
    return PosedFrame(lidar_frame, where, odometry, static_residual_m, reason)


def scattered(count: int, *, n: int = 800, lost: Collection[int] = ()) -> list[PosedFrame]:
    """Make frames of random points, a tenth of them invalid, of a sensor that stands."""
    rng = np.random.default_rng(5)
    frames = []
    for number in range(count):
        points = rng.normal(scale=(15, 15, 1), size=(n, 3)).astype(np.float32)
        valid = rng.random(n) > 0.1
        points[~valid] = 0
        intensity = rng.random(n).astype(np.float32)
        made = frame(points, at_s=number / 10, intensity=intensity, valid_mask=valid)
        state = OdometryState.LOST if number in lost else OdometryState.HEALTHY
        frames.append(posed(made, odometry=state))
    return frames


def said(
    labels: ArrayLike, *, confidence: ArrayLike = 1.0, ground: ArrayLike | None = None
) -> FrameLabels:
    """Make one stream's answers for a frame; equally sure of all of them."""
    answers = np.array(labels, dtype=np.uint8)
    sure = np.broadcast_to(np.asarray(confidence, dtype=np.float16), answers.shape).copy()
    ground_mask = None if ground is None else np.array(ground, dtype=np.bool_)
    return FrameLabels(answers, sure, ground_mask=ground_mask)


def labelled(
    points_m: ArrayLike, semantic: ArrayLike, predictive: ArrayLike, *, at_s: float = 0.0
) -> LabelledFrame:
    """Make a frame with both streams' labels and their agreement."""
    one, other = said(semantic), said(predictive)
    agreements = compare(one.labels, other.labels)
    return LabelledFrame(posed(frame(points_m, at_s=at_s)), one, other, agreements)


def scene(frames: Sequence[LabelledFrame], **changes: Any) -> Scene:
    """Make a scene of labelled frames."""
    fields: dict[str, Any] = {
        "scene_id": f"{LOG_ID}/lidar.points/{frames[0].stamp_ns}",
        "frames": tuple(frames),
    }
    return Scene(**(fields | changes))


def recorded(
    motion: ArrayLike | None, *, class_id: ArrayLike | None = None, **changes: Any
) -> RecordedLabels:
    """Make what the model that ran on the car said about one frame."""
    values = None if motion is None else np.array(motion, dtype=np.uint8)
    ids = np.zeros(0 if values is None else len(values), dtype=np.uint16)
    fields: dict[str, Any] = {
        "class_id": ids if class_id is None else np.array(class_id, dtype=np.uint16),
        "motion": values,
        "confidence": None,
        "classes": {},
    }
    return RecordedLabels(**(fields | changes))


def track_record(**changes: Any) -> TrackRecord:
    """Make a contradicting track of twenty frames that only the self-supervised stream sees."""
    strongest = InstanceRecord(
        stamp_ns=BEGIN_NS + NS_PER_S,
        points=120,
        centre_m=(12.0, 3.0, 0.0),
        size_m=(4.2, 1.8, 1.4),
        yaw_rad=0.1,
        range_m=12.4,
        semantic_confidence=0.9,
        predictive_confidence=0.8,
    )
    fields: dict[str, Any] = {
        "track_id": 0,
        "kind": ContradictionKind.ONLY_PREDICTIVE_DYNAMIC,
        "class_name": "car",
        "strength": 0.5,
        "first_ns": BEGIN_NS,
        "last_ns": BEGIN_NS + 19 * FRAME_STEP_NS,
        "frames": 20,
        "points": 2_000,
        "speed_m_per_s": 6.0,
        "strongest": strongest,
    }
    return TrackRecord(**(fields | changes))


def track_at(range_m: float, **changes: Any) -> TrackRecord:
    """Make such a track at a range, metres, ahead."""
    record = track_record(**changes)
    where = {"centre_m": (range_m, 0.0, 0.0), "range_m": range_m}
    return record.model_copy(update={"strongest": record.strongest.model_copy(update=where)})


def scene_score(*, number: int = 0, score: float = 0.5, **changes: Any) -> SceneScore:
    """Make the record of the `number`-th scene of two seconds of a log."""
    log_id = changes.get("log_id", LOG_ID)
    start_ns = BEGIN_NS + 2 * number * NS_PER_S
    shares = AgreementShares(
        both_static=0.9, both_dynamic=0.06, only_semantic_dynamic=0.01, only_predictive_dynamic=0.03
    )
    fields: dict[str, Any] = {
        "scene_id": f"{log_id}/lidar.points/{start_ns}",
        "log_id": log_id,
        "lidar_topic": "/lidar/points",
        "vehicle": "car-7",
        "date": "2026-03-02",
        "software_version": "2026.1",
        "start_ns": start_ns,
        "end_ns": start_ns + 19 * FRAME_STEP_NS,
        "frames": 20,
        "state": SceneState.SCORED,
        "score": score,
        "reasons": (Reason(headline="supervised calls car static, but it moves"),),
        "points": 40_000,
        "compared_share": 0.8,
        "all_points": shares,
        "nonground_points": shares,
        "totals": tuple(
            KindTotal(kind=kind, instances=1, tracks=1, points=120) for kind in ContradictionKind
        ),
        "tracks": (track_record(),),
        "odometry": OdometryHealth(
            state=OdometryState.HEALTHY,
            healthy_share=1.0,
            static_residual_m=0.05,
            distance_m=12.0,
        ),
        "producers": Producers(
            supervised="recorded@1",
            selfsupervised="registration@1",
            pipeline_version="0123456789ab",
        ),
    }
    return SceneScore(**(fields | changes))


def street_log(
    path: Path,
    *,
    frames: int = 30,
    seed: int = 1,
    style: EgoStyle = "drives",
    lidar: Lidar = SMALL_LIDAR,
    recorded_as: RecordedAs = "fields",
    failures: Sequence[PlantedFailure] = (),
    truth: Path | None = None,
    odometry: bool = False,
    fixes: bool = False,
    lidars: int = 1,
    chunk_bytes: int = 200_000,
    **identity: Any,
) -> Path:
    """Write a small log of a simulated street, for tests that need a real one."""
    street = build_street(seed, seconds=frames * lidar.period_s, style=style)
    write_log(
        path,
        street,
        lidar=lidar,
        further=further_lidars(lidar, lidars - 1),
        identity=Identity(**identity),
        recorded=recorded_as,
        odometry=odometry,
        fixes=fixes,
        planted=PlantedFaults(failures=tuple(failures)),
        truth=truth,
        chunk_bytes=chunk_bytes,
        frames=frames,
    )
    return path


def missed_and_phantom(street: Street) -> PlantedFaults:
    """Let the model on the car miss every second mover, and call every fourth parked car moving."""
    failures = [
        PlantedFailure(
            FailureKind.PARKED_CALLED_MOVING if actor.parked else FailureKind.MISSED_MOVER,
            track,
            0.0,
            street.seconds + 1.0,
        )
        for track, actor in enumerate(street.actors)
        if track % (4 if actor.parked else 2) == 0
    ]
    return PlantedFaults(failures=tuple(failures))
