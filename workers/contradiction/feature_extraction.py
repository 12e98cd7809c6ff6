"""Feature extraction: features of a track (`track_features.py`) from it and its scene context."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from schemas.labels import MotionLabel
from workers.contradiction.bled_labels import bled_likeness
from workers.contradiction.blind_moments import blind_share, witness_votes
from workers.contradiction.bulk_motion import bulk_motion_of
from workers.contradiction.clamp import clamp01
from workers.contradiction.flashes import has_no_motion_source, label_time
from workers.contradiction.rims import rim_likeness
from workers.contradiction.rising_ground import RisingGround, rising_share
from workers.contradiction.scene_context import SceneContext, scene_context_of
from workers.contradiction.settings import DEFAULT_FEATURES, FeatureSettings
from workers.contradiction.shape_persistence import ShapePersistence, shape_persistence_of
from workers.contradiction.size_priors import box_plausibility
from workers.contradiction.standing_ghosts import path_share, standing_share
from workers.contradiction.temporal_context import temporal_context_of
from workers.contradiction.track_features import DescribedTrack, TrackFeatures
from workers.contradiction.track_motion import motion_plausibility, path_of
from workers.contradiction.tracks import Track

_FAR_M: Final = 80.0
_TURN_RAD_PER_S: Final = 0.3
_FAST_M_PER_S: Final = 10.0
_CLUTTER: Final = 8.0
_LONG_M: Final = 12.0
_TALL_M: Final = 3.0
_THIN_M: Final = 0.4
_LOW_M: Final = 1.0
_LOWEST_M: Final = 0.5
_LOW_WITHIN_M: Final = 50.0
_RISES_SHARE: Final = 0.03
_RISES_ALL: Final = 0.1
"""Shares of rising ground around an object at which feature `rising_ground` is 0 and 1."""

_DEPARTURE_UNSEEN_S: Final = 0.5
_DEPARTURE_SEEN_S: Final = 1.0
"""Times observed from the first frame on, seconds, at which feature `log_end` is 1 and 0.

An object that sets off at 1.5 m/s2 covers 0.2 m and 0.75 m in them: too little and enough to show.
"""

_MIN_EVIDENCE: Final = 0.1
"""Product of `duration` and `point_count` from which on shape persistence is tested."""


def extract_features(
    scene: Scene,
    instances: Sequence[Instance],
    tracks: Sequence[Track],
    *,
    settings: FeatureSettings = DEFAULT_FEATURES,
) -> tuple[DescribedTrack, ...]:
    """Extract the features of every track of a scene.

    Args:
        scene: The scene.
        instances: Its instances.
        tracks: Their tracks.
        settings: Scales of duration, points and size.

    Returns:
        One described track per track, in their order.
    """
    if not tracks:
        return ()
    context = scene_context_of(scene, instances)
    return tuple(_describe(scene, track, instances, context, settings) for track in tracks)


def _describe(
    scene: Scene,
    track: Track,
    instances: Sequence[Instance],
    context: SceneContext,
    settings: FeatureSettings,
) -> DescribedTrack:
    members = tuple(instances[i] for i in track.members)
    size_m = np.median([member.size_m for member in members], axis=0)
    features = _features_of(scene, track, members, size_m, context, settings)
    return DescribedTrack(track, members, size_m, features)


def _features_of(
    scene: Scene,
    track: Track,
    members: Sequence[Instance],
    size_m: NDArray[np.float64],
    context: SceneContext,
    settings: FeatureSettings,
) -> TrackFeatures:
    points = np.array([len(member.point_index) for member in members], dtype=np.float64)
    at = np.array([member.frame_index for member in members])
    stamps_s = np.array([(scene.frames[i].stamp_ns - scene.start_ns) / NS_PER_S for i in at])
    places_m = places_in_odom(scene, members)
    path = path_of(track.centres_m, stamps_s, [each[:, :2] for each in places_m])
    temporal = temporal_context_of(
        *(scene, members, track.centres_m, path.velocity_m_per_s, context.dynamic_points),
        period_s=context.period_s,
    )
    path_weight = 1.0 if track.kind.semantic == scene.task.moving else path.straightness
    witness_dynamic, witness_static = _witness_shares(scene, members)
    velocities = np.stack([member.velocity_m_per_s for member in members])
    speeds = np.linalg.norm(velocities, axis=1)
    speed_consistency = 0.0
    if track.kind.measured or track.kind.of_witness:
        speed_consistency = motion_plausibility(track.centres_m, stamps_s, velocities, settings)
    lasts_s = float(stamps_s[-1] - stamps_s[0])
    first_ns = scene.frames[at[0]].stamp_ns
    observed_s = float(context.dynamic_points.stamps_ns[-1] - first_ns) / NS_PER_S
    kind = track.kind.name
    duration = 1.0 - math.exp(-lasts_s / settings.persistence_s)
    point_count = 1.0 - math.exp(-float(np.median(points)) / settings.evidence_points)
    persistence = ShapePersistence()
    if scene.task.moving and duration * point_count >= _MIN_EVIDENCE:
        persistence = shape_persistence_of(
            scene, members, places_m, path.velocity_m_per_s, context.keyframes
        )

    def mean(values: Sequence[float]) -> float:
        return float(np.average(values, weights=points))

    shape_static = min(persistence.here_before, persistence.here_after)
    standing = standing_share(
        track.kind, scene.task, shape_static=shape_static, witness_static=witness_static
    )
    bled = 0.0
    if has_no_motion_source(track.kind, scene.task):
        bled = context.agreed_directions.share(members)
    standing *= 1.0 - bled
    travels = 1.0 - standing
    free = path_share(track.kind, scene.task, witness_static=witness_static)
    arrived, departed = persistence.elsewhere_before * free, persistence.elsewhere_after * free
    confirmed = clamp01(mean([_confirmed_share(member.confirmed_share) for member in members]))
    pose_doubted = mean(context.doubted[at].tolist())
    bulk_motion = bulk_motion_of(
        points=float(np.median(points)),
        confirmed=confirmed if track.kind.measured else 0.0,
        speed_m_per_s=float(np.median(speeds)),
        pose_doubted=pose_doubted,
    )
    isolation = clamp01(mean([member.own_share for member in members]))
    rim = rim_likeness(members)
    agreed_share = clamp01(mean([member.agreed_share for member in members]))
    denied_share = clamp01(
        mean([member.denied_share for member in members]) + agreed_share * (1.0 - rim)
    )
    agreed_share *= rim
    bleeding = bled_likeness(bled, isolation=isolation)
    agreed_share += denied_share * bleeding
    denied_share *= 1.0 - bleeding
    range_m = mean([float(np.hypot(*m.centre_m[:2])) for m in members])
    return TrackFeatures(
        witness_dynamic=witness_dynamic,
        witness_static=witness_static,
        displacement=path.displacement * travels,
        straightness=max(path.straightness * travels, bulk_motion),
        duration=duration,
        continuity=len(members) / float(at[-1] - at[0] + 1),
        point_count=point_count,
        distance=clamp01(range_m / _FAR_M),
        road_user_size=clamp01(box_plausibility(size_m, settings)),
        length=clamp01(float(size_m[0]) / _LONG_M) * (1.0 - bulk_motion),
        height=clamp01(float(size_m[2]) / _TALL_M),
        thinness=clamp01(1.0 - float(size_m[1]) / _THIN_M),
        lowness=clamp01((_LOW_M - float(size_m[2])) / _LOWEST_M)
        * clamp01(1.0 - range_m / _LOW_WITHIN_M),
        agreed_before=temporal.agreed_before * path_weight,
        not_refuted_after=temporal.not_refuted_after * path_weight,
        dynamic_before=temporal.dynamic_before,
        dynamic_after=temporal.dynamic_after,
        shape_static=shape_static,
        shape_static_after=persistence.here_after * (1.0 - bulk_motion),
        arrived=arrived,
        departed=departed,
        transits=min(arrived, departed),
        log_end=clamp01(
            (_DEPARTURE_SEEN_S - observed_s) / (_DEPARTURE_SEEN_S - _DEPARTURE_UNSEEN_S)
        ),
        isolation=isolation,
        supervised_confidence=clamp01(mean([member.semantic_confidence for member in members])),
        selfsupervised_confidence=clamp01(
            mean([member.predictive_confidence for member in members])
        ),
        confirmed=confirmed,
        speed_consistency=clamp01(speed_consistency),
        speed=clamp01(float(np.median(speeds)) / _FAST_M_PER_S),
        pose_doubted=pose_doubted,
        turn_rate=clamp01(float(context.turn_rad_per_s[at].max()) / _TURN_RAD_PER_S),
        unobserved=clamp01(float(context.unobserved[at].mean())),
        denied_share=denied_share,
        agreed_share=agreed_share,
        unlabelled_share=_unlabelled_share(scene, members),
        clutter=1.0
        - math.exp(
            -(float(np.median([context.clutter[kind, i] for i in at.tolist()])) - 1) / _CLUTTER
        ),
        rising_ground=_rising_ground(members, context.ground),
        blind_share=blind_share(scene, members),
        witness_votes=witness_votes(scene, members),
        bulk_motion=bulk_motion,
        label_time=label_time(
            *(track.kind, scene.task), frames=temporal.frames_alone, period_s=context.period_s
        ),
    )


def places_in_odom(scene: Scene, members: Sequence[Instance]) -> list[NDArray[np.float64]]:
    """Return the points (M, 3) of each instance, odom space, metres."""
    places = []
    for member in members:
        posed = scene.frames[member.frame_index].posed
        points_m = posed.frame.points_m[member.point_index].astype(np.float64)
        pose = posed.odom_from_sensor
        places.append(points_m @ pose[:3, :3].T + pose[:3, 3])
    return places


def _witness_shares(scene: Scene, members: Sequence[Instance]) -> tuple[float, float]:
    """Return the shares of a track's points that the witness labels dynamic and static."""
    counts = np.zeros(3)
    for member in members:
        witness = scene.frames[member.frame_index].witness
        if witness is None:
            counts[MotionLabel.UNKNOWN] += len(member.point_index)
            continue
        counts += np.bincount(witness.labels[member.point_index], minlength=3)
    shares = counts / max(1.0, float(counts.sum()))
    return float(shares[MotionLabel.DYNAMIC]), float(shares[MotionLabel.STATIC])


def _unlabelled_share(scene: Scene, members: Sequence[Instance]) -> float:
    """Return the share of a track's points without a label of the self-supervised stream."""
    silent = total = 0
    for member in members:
        labels = scene.frames[member.frame_index].predictive.labels[member.point_index]
        silent += int((labels == MotionLabel.UNKNOWN).sum())
        total += len(labels)
    return silent / max(1, total)


def _rising_ground(members: Sequence[Instance], ground: RisingGround) -> float:
    share = rising_share([ground.around(each.frame_index, each.point_index) for each in members])
    return clamp01((share - _RISES_SHARE) / (_RISES_ALL - _RISES_SHARE))


def _confirmed_share(share: float | None) -> float:
    return 1.0 if share is None else share
