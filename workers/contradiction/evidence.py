"""What is known about one track, as named numbers between 0 and 1: what attribution rests on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from schemas.frame import OdometryState
from schemas.labels import MotionLabel
from workers.contradiction.before_after import CalledMoving, at_other_times, called_moving
from workers.contradiction.glances import Glances
from workers.contradiction.paths import path_of
from workers.contradiction.settings import DEFAULT_SCORE, ScoreSettings
from workers.contradiction.tracks import Track, frame_period_s
from workers.contradiction.unit import clip
from workers.contradiction.whereabouts import Whereabouts, whereabouts_of
from workers.visibility.rising_ground import RisingGround, share_of

_FAR_M: Final = 80.0
_TURN_RAD_PER_S: Final = 0.3
_FAST_M_PER_S: Final = 10.0
_CROWD: Final = 8.0
_LONG_M: Final = 12.0
_TALL_M: Final = 3.0
_THIN_M: Final = 0.4
_LOW_M: Final = 1.0
_LOWEST_M: Final = 0.5
_LOW_WITHIN_M: Final = 50.0
_RISES_SHARE: Final = 0.03
_RISES_ALL: Final = 0.1
"""Shares of the ground around a thing that rises."""

_WORTH_IT: Final = 0.1
"""`lasting` times `many_points`, from which on it is asked where a thing was and will be."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Named, bounded numbers; every one is 0 to 1.

    Attributes:
        witness_moving: Share of its points that the witness calls dynamic.
        witness_still: Share of its points that the witness calls static.
        went: How far both its ends went over the ground along a straight line: half at a metre.
        straight: How much of that is a path, and how much the box jumps about.
        lasting: Seconds seen: 0.63 at half a second.
        steady: Share of the frames of its span in which it contradicts.
        many_points: Median points a frame: 0.63 at 25.
        far: Range over 80 m.
        road_user: Whether its box has the size of one.
        long: Length over 12 m.
        tall: Height over 3 m.
        thin: Whether its box is thinner than 0.4 m.
        low: Whether it is lower than a metre: 1 at half of that; near alone, as of what is far a
            lidar sees few rows, and nothing says how high it is: none from 50 m on.
        agreed_before: Share of it that both streams call moving, in the best third of a second of
            the first half of its track and of the second before; of what the supervised stream
            calls static, as far as it goes straight: what stops is remembered as moving for a
            while.
        undenied_after: Share that the supervised stream calls moving and the other one does not
            call static, in its second half and the second after; likewise as far as it goes
            straight.
        called_before: Share of it that the supervised stream calls moving earlier, whatever the
            other one says.
        called_after: And later.
        stays: Its shape lies in the same place half a second to two seconds before and after
            (`whereabouts.py`); asked of what lasts and has points.
        stands_after: It does after, whatever it did before.
        came: It lay elsewhere before, and one velocity leads from there to here.
        leaves: It lies elsewhere after. All are 0 where it is hidden, or the log ends.
        passes: It came, and leaves: what only stops or sets off does one of both.
        own: Share of its surroundings that contradict alike.
        supervised_sure: Mean confidence of the supervised stream.
        selfsupervised_sure: Mean confidence of the self-supervised stream.
        confirmed: Share of its points proved to move more than once; 1 where that is not told.
        speed_fits: How well its path bears out the measured speed; 0 where none was measured.
        fast: Measured speed over 10 m/s.
        doubted: Share of its frames whose pose is not healthy.
        turning: How fast the sensor turned: 1 at 0.3 rad/s.
        unseen: Share of the places asked about in its frames that no other frame saw.
        denied: Of all that is called dynamic around it, share that the other stream calls static.
        agreed: And dynamic: the rim of a thing that both see move.
        silent: Share of its points that the self-supervised stream says nothing about.
        crowded: Whether much else contradicts in the same way in its frames: 0.63 at eight.
        ground_rises: How much of the ground around it rises where nothing stands
            (`rising_ground.py`): none up to 3 %, 1 from a tenth on.
    """

    witness_moving: float
    witness_still: float
    went: float
    straight: float
    lasting: float
    steady: float
    many_points: float
    far: float
    road_user: float
    long: float
    tall: float
    thin: float
    low: float
    agreed_before: float
    undenied_after: float
    called_before: float
    called_after: float
    stays: float
    stands_after: float
    came: float
    leaves: float
    passes: float
    own: float
    supervised_sure: float
    selfsupervised_sure: float
    confirmed: float
    speed_fits: float
    fast: float
    doubted: float
    turning: float
    unseen: float
    denied: float
    agreed: float
    silent: float
    crowded: float
    ground_rises: float

    def named(self) -> dict[str, float]:
        """All of them by name, rounded."""
        return {name: round(float(getattr(self, name)), 4) for name in NAMES}


NAMES: Final = tuple(field.name for field in fields(Evidence))


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What the tracks of a scene share: worked out once.

    Attributes:
        turn_rad_per_s: (F,) how fast the sensor turned in each frame.
        unseen: (F,) share of what was asked about that no other frame saw.
        doubted: (F,) 1 where the pose is not healthy.
        crowd: Instances of each kind in each frame.
        called: What the supervised stream calls moving, right before and after the scene as well.
        glances: What stands off the ground every half second of it.
        period_s: Between its frames.
        ground: Where the ground itself rises.
    """

    turn_rad_per_s: NDArray[np.float64]
    unseen: NDArray[np.float64]
    doubted: NDArray[np.float64]
    crowd: dict[tuple[str, int], int]
    called: CalledMoving
    glances: Glances
    period_s: float
    ground: RisingGround


def surroundings_of(scene: Scene, instances: Sequence[Instance]) -> Surroundings:
    """Work out what all tracks of a scene share."""
    frames = scene.frames
    poses = np.stack([frame.posed.odom_from_sensor for frame in frames])
    heading = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    stamps_s = np.array([(frame.stamp_ns - scene.start_ns) / NS_PER_S for frame in frames])
    turn = np.zeros(len(frames))
    if len(frames) > 1 and (np.diff(stamps_s) > 0).all():  # where time stands, no rate is known
        turn = np.gradient(heading, stamps_s)
    seen = [
        frame.witness.health.seen_share if frame.witness is not None else math.nan
        for frame in frames
    ]
    crowd: dict[tuple[str, int], int] = {}
    for instance in instances:
        key = (instance.kind.name, instance.frame_index)
        crowd[key] = crowd.get(key, 0) + 1
    return Surroundings(
        turn_rad_per_s=np.abs(turn),
        unseen=1.0 - np.nan_to_num(np.array(seen), nan=0.0),
        doubted=np.array([float(f.posed.odometry is not OdometryState.HEALTHY) for f in frames]),
        crowd=crowd,
        called=called_moving(scene),
        glances=Glances(scene),
        period_s=frame_period_s(scene),
        ground=RisingGround([frame.posed for frame in frames]),
    )


def evidence_of(
    scene: Scene,
    track: Track,
    members: Sequence[Instance],
    around: Surroundings,
    *,
    road_user: float,
    speed_fits: float,
    settings: ScoreSettings = DEFAULT_SCORE,
) -> Evidence:
    """Gather what is known about a track.

    Args:
        scene: Where it was found.
        track: The track.
        members: Its instances.
        around: What all tracks of the scene share.
        road_user: How much its box looks like one.
        speed_fits: How well its path bears out a measured speed; 0 where none is.
        settings: Scales of time and points.
    """
    points = np.array([len(member.point_index) for member in members], dtype=np.float64)
    at = np.array([member.frame_index for member in members])
    stamps_s = np.array([(scene.frames[i].stamp_ns - scene.start_ns) / NS_PER_S for i in at])
    size_m = np.median([member.size_m for member in members], axis=0)
    places_m = places_in_odom(scene, members)
    path = path_of(track.centres_m, stamps_s, [each[:, :2] for each in places_m])
    others = at_other_times(
        *(scene, members, track.centres_m, path.velocity_m_per_s, around.called),
        period_s=around.period_s,
    )
    goes_on = 1.0 if track.kind.semantic == scene.task.moving else path.straight
    moving, still = _testimony(scene, members)
    speeds = np.linalg.norm([member.velocity_m_per_s for member in members], axis=1)
    lasts_s = float(stamps_s[-1] - stamps_s[0])
    kind = track.kind.name
    lasting = 1.0 - math.exp(-lasts_s / settings.persistence_s)
    many_points = 1.0 - math.exp(-float(np.median(points)) / settings.evidence_points)
    where = Whereabouts()
    if scene.task.moving and lasting * many_points >= _WORTH_IT:
        where = whereabouts_of(scene, members, places_m, path.velocity_m_per_s, around.glances)

    def mean(values: Sequence[float]) -> float:
        return float(np.average(values, weights=points))

    range_m = mean([float(np.hypot(*m.centre_m[:2])) for m in members])
    return Evidence(
        witness_moving=moving,
        witness_still=still,
        went=path.went,
        straight=path.straight,
        lasting=lasting,
        steady=len(members) / float(at[-1] - at[0] + 1),
        many_points=many_points,
        far=clip(range_m / _FAR_M),
        road_user=clip(road_user),
        long=clip(float(size_m[0]) / _LONG_M),
        tall=clip(float(size_m[2]) / _TALL_M),
        thin=clip(1.0 - float(size_m[1]) / _THIN_M),
        low=clip((_LOW_M - float(size_m[2])) / _LOWEST_M) * clip(1.0 - range_m / _LOW_WITHIN_M),
        agreed_before=others.agreed_before * goes_on,
        undenied_after=others.undenied_after * goes_on,
        called_before=others.called_before,
        called_after=others.called_after,
        stays=min(where.here_before, where.here_after),
        stands_after=where.here_after,
        came=where.elsewhere_before,
        leaves=where.elsewhere_after,
        passes=min(where.elsewhere_before, where.elsewhere_after),
        own=clip(mean([member.own_share for member in members])),
        supervised_sure=clip(mean([member.semantic_confidence for member in members])),
        selfsupervised_sure=clip(mean([member.predictive_confidence for member in members])),
        confirmed=clip(mean([_told(member.confirmed_share) for member in members])),
        speed_fits=clip(speed_fits),
        fast=clip(float(np.median(speeds)) / _FAST_M_PER_S),
        doubted=mean(around.doubted[at].tolist()),
        turning=clip(float(around.turn_rad_per_s[at].max()) / _TURN_RAD_PER_S),
        unseen=clip(float(around.unseen[at].mean())),
        denied=clip(mean([member.denied_share for member in members])),
        agreed=clip(mean([member.agreed_share for member in members])),
        silent=_silence(scene, members),
        crowded=1.0
        - math.exp(-(float(np.median([around.crowd[kind, i] for i in at.tolist()])) - 1) / _CROWD),
        ground_rises=_rises(members, around.ground),
    )


def places_in_odom(scene: Scene, members: Sequence[Instance]) -> list[NDArray[np.float64]]:
    """(M, 3) points of each instance, odom space."""
    places = []
    for member in members:
        posed = scene.frames[member.frame_index].posed
        points_m = posed.frame.points_m[member.point_index].astype(np.float64)
        pose = posed.odom_from_sensor
        places.append(points_m @ pose[:3, :3].T + pose[:3, 3])
    return places


def _testimony(scene: Scene, members: Sequence[Instance]) -> tuple[float, float]:
    """Shares of the points of a track that the witness calls dynamic and static."""
    counts = np.zeros(3)
    for member in members:
        witness = scene.frames[member.frame_index].witness
        if witness is None:
            counts[MotionLabel.UNKNOWN] += len(member.point_index)
            continue
        counts += np.bincount(witness.labels[member.point_index], minlength=3)
    shares = counts / max(1.0, float(counts.sum()))
    return float(shares[MotionLabel.DYNAMIC]), float(shares[MotionLabel.STATIC])


def _silence(scene: Scene, members: Sequence[Instance]) -> float:
    """Share of the points of a track that the self-supervised stream does not judge."""
    silent = total = 0
    for member in members:
        said = scene.frames[member.frame_index].predictive.labels[member.point_index]
        silent += int((said == MotionLabel.UNKNOWN).sum())
        total += len(said)
    return silent / max(1, total)


def _rises(members: Sequence[Instance], ground: RisingGround) -> float:
    share = share_of([ground.around(each.frame_index, each.point_index) for each in members])
    return clip((share - _RISES_SHARE) / (_RISES_ALL - _RISES_SHARE))


def _told(share: float | None) -> float:
    return 1.0 if share is None else share
