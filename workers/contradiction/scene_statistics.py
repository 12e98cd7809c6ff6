"""Scene statistics that need no instances: shares of outcomes, health of poses and of a stream."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.contradiction import LabelledFrame, Scene
from schemas.frame import OdometryState
from schemas.score import AgreementShares, OdometryHealth, StreamHealth, SupervisedHealth
from schemas.surroundings import CloudStatistics, ScenePlace
from schemas.task import Task
from workers.contradiction.cloud_statistics import cloud_statistics
from workers.contradiction.scene_place import scene_place

SHARE_DIGITS: Final = 4
MAX_REASON_LENGTH: Final = 200


@dataclass(frozen=True, slots=True)
class PointShares:
    """Shares of a scene's points by outcome.

    Attributes:
        points: All points, invalid ones included.
        compared_share: Share of them that both streams labelled.
        all_points: Shares over all compared points.
        nonground_points: Shares over compared points that the self-supervised stream does not label
            ground; equal to `all_points` when it does not segment ground.
    """

    points: int
    compared_share: float
    all_points: AgreementShares
    nonground_points: AgreementShares


@dataclass(frozen=True, slots=True)
class SceneStatistics:
    """Statistics of a scene that its record and the reasons of its score state.

    Attributes:
        shares: Shares of its points by outcome.
        odometry: Health of its poses.
        stream: Health of the self-supervised stream.
        supervised: Health of the supervised stream; None where it answers everything.
        remark: First remark on its poses; empty without one.
        compared: True if any point was labelled by both streams.
        supervised_silent: True if the supervised stream labelled no point.
        selfsupervised_silent: True if the self-supervised stream labelled no point.
        cloud: Statistics of its clouds; None without a return.
        place: Where it was recorded; None where its log does not record it.
    """

    shares: PointShares
    odometry: OdometryHealth
    stream: StreamHealth
    supervised: SupervisedHealth | None
    remark: str
    compared: bool
    supervised_silent: bool
    selfsupervised_silent: bool
    cloud: CloudStatistics | None
    place: ScenePlace | None


def statistics_of(scene: Scene) -> SceneStatistics:
    """Compute the statistics of a scene."""
    frames, unknown = scene.frames, scene.task.unknown
    compared = any((frame.agreements != scene.task.not_compared).any() for frame in frames)
    return SceneStatistics(
        shares=point_shares(frames),
        odometry=odometry_health(scene),
        stream=stream_health(scene),
        supervised=supervised_health(scene),
        remark=next((frame.posed.remark for frame in frames if frame.posed.remark), ""),
        compared=compared,
        supervised_silent=not compared
        and all((frame.semantic.labels == unknown).all() for frame in frames),
        selfsupervised_silent=not compared
        and all((frame.predictive.labels == unknown).all() for frame in frames),
        cloud=cloud_statistics(frames),
        place=scene_place(scene),
    )


def point_shares(frames: Sequence[LabelledFrame]) -> PointShares:
    """Count the outcomes over all points, and over those off the ground.

    Ground may dilute a small contradiction.
    """
    task = frames[0].task
    outcomes = len(task.outcomes)
    every = np.zeros(outcomes, dtype=np.int64)
    off_ground = np.zeros(outcomes, dtype=np.int64)
    for frame in frames:
        every += np.bincount(frame.agreements, minlength=outcomes)
        ground_mask = frame.predictive.ground_mask
        kept = frame.agreements if ground_mask is None else frame.agreements[~ground_mask]
        off_ground += np.bincount(kept, minlength=outcomes)
    points = int(every.sum())
    compared = points - int(every[task.not_compared])
    return PointShares(
        points=points,
        compared_share=round(compared / points, SHARE_DIGITS) if points else 0.0,
        all_points=_shares(every, task),
        nonground_points=_shares(off_ground, task),
    )


def odometry_health(scene: Scene) -> OdometryHealth:
    """Summarise the poses of a scene: the worst state, its reason, and the path of the sensor."""
    posed = [frame.posed for frame in scene.frames]
    worst = max((pose.odometry for pose in posed), key=list(OdometryState).index)
    residuals = [p.static_residual_m for p in posed if math.isfinite(p.static_residual_m)]
    positions_m = np.stack([pose.odom_from_sensor[:3, 3] for pose in posed])
    steps_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    reason = next((p.reason for p in posed if p.odometry is worst and p.reason), "")
    return OdometryHealth(
        state=worst,
        healthy_share=round(
            sum(p.odometry is OdometryState.HEALTHY for p in posed) / len(posed), SHARE_DIGITS
        ),
        static_residual_m=round(float(np.median(residuals)), 3) if residuals else 0.0,
        distance_m=round(float(steps_m.sum()), 2),
        reason="" if worst is OdometryState.HEALTHY else reason[:MAX_REASON_LENGTH],
    )


def stream_health(scene: Scene) -> StreamHealth:
    """Summarise the input of the self-supervised stream, and its commonest cause of blindness."""
    returns = unknown = 0
    for frame in scene.frames:
        valid = frame.posed.frame.valid_mask
        returns += int(valid.sum())
        unknown += int((frame.predictive.labels[valid] == scene.task.unknown).sum())
    health = [frame.predictive.health for frame in scene.frames]
    blind = [each for each in health if each.blindness is not None]
    causes = Counter(each.blindness for each in blind)
    commonest = causes.most_common(1)[0][0] if causes else None
    reason = next((each.reason for each in blind if each.blindness is commonest), "")
    seen = [each.seen_share for each in health if math.isfinite(each.seen_share)]
    return StreamHealth(
        unknown_share=round(unknown / returns, SHARE_DIGITS) if returns else 0.0,
        seen_share=round(sum(seen) / len(seen), SHARE_DIGITS) if seen else None,
        blind_share=round(len(blind) / len(health), SHARE_DIGITS),
        pose_jumps=sum(frame.posed.jumped for frame in scene.frames),
        reason=reason[:MAX_REASON_LENGTH],
    )


def supervised_health(scene: Scene) -> SupervisedHealth | None:
    """Summarise what the supervised stream leaves open; None where it answers everything."""
    health = [frame.semantic.health for frame in scene.frames]
    unanswered = sum(not each.answered for each in health)
    reason = next((each.reason for each in health if each.reason), "")
    if not unanswered and not reason:
        return None
    returns = labelled = 0
    for frame in scene.frames:
        valid = frame.posed.frame.valid_mask
        returns += int(valid.sum())
        labelled += int((frame.semantic.labels[valid] < scene.task.unknown).sum())
    return SupervisedHealth(
        labelled_share=round(labelled / returns, SHARE_DIGITS) if returns else 0.0,
        unanswered_share=round(unanswered / len(health), SHARE_DIGITS),
        reason=reason[:MAX_REASON_LENGTH],
    )


def _shares(counts: NDArray[np.int64], task: Task) -> AgreementShares:
    compared = int(counts[: task.not_compared].sum())
    share = {
        outcome.name: round(int(counts[outcome.code]) / compared, SHARE_DIGITS) if compared else 0.0
        for outcome in task.compared()
    }
    return AgreementShares(**share)
