"""What a recorder, a network or a sensor may do to frames, put through the whole of the method."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import Agreement, Blindness, MotionLabel
from schemas.score import SceneScore
from tests.factories import frame, pose, recorded
from tests.labelled_worlds import START_NS, shard_of
from workers.lab.simulation.sensor.lidar import UNIFORM_64, Lidar, sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.odometry.odometry import KissOdometry
from workers.parts.protocols import Odometry, Parts
from workers.pipeline import mine_shard
from workers.selfsupervised.stream import Registration
from workers.supervised.recorded import Recorded

LIDAR = Lidar(elevation_deg=UNIFORM_64[::2], columns=400)
FRAMES, BAD = 16, 8
PERIOD_NS = NS_PER_S // 10

Frames = list[LidarFrame]


@cache
def street() -> tuple[LidarFrame, ...]:
    """A drive down a street; the model on the car is right about every point."""
    world = build_street(3, seconds=FRAMES * LIDAR.period_s, style="drives")
    made = []
    for index in range(FRAMES):
        seen = sweep(world, LIDAR, index)
        made.append(
            frame(
                seen.points_m,
                stamp_ns=START_NS + index * PERIOD_NS,
                ring=seen.ring.astype(np.int16),
                recorded=recorded(seen.motion),
            )
        )
    return tuple(made)


def like(lidar_frame: LidarFrame, points_m: object, *, ring: int = -1) -> LidarFrame:
    """Give another cloud the time of a frame; what is no number is marked as the reader does."""
    points = np.array(points_m, dtype=np.float32).reshape(-1, 3)
    valid = np.isfinite(points).all(axis=1)
    valid &= (points != 0.0).any(axis=1)
    return frame(
        np.where(valid[:, None], points, 0.0),
        stamp_ns=lidar_frame.stamp_ns,
        ring=np.full(len(points), ring, np.int16),
        valid_mask=valid,
        recorded=recorded(np.ones(len(points), np.uint8)),
    )


def at_bad(change: Callable[[LidarFrame], LidarFrame]) -> Callable[[Frames], Frames]:
    return lambda frames: [change(f) if i == BAD else f for i, f in enumerate(frames)]


def from_bad(change: Callable[[LidarFrame], LidarFrame]) -> Callable[[Frames], Frames]:
    return lambda frames: [change(f) if i >= BAD else f for i, f in enumerate(frames)]


def later(lidar_frame: LidarFrame, *, by_s: float) -> LidarFrame:
    return replace(lidar_frame, stamp_ns=lidar_frame.stamp_ns + round(by_s * NS_PER_S))


def beside(lidar_frame: LidarFrame, *, x_m: float, y_m: float) -> LidarFrame:
    """The same cloud as seen from elsewhere: the car was put there by a crane."""
    moved = lidar_frame.points_m - np.array([x_m, y_m, 0.0], np.float32)
    return replace(lidar_frame, points_m=moved)


def crowded(lidar_frame: LidarFrame) -> LidarFrame:
    """300,000 points: every return many times over, with a millimetre of noise."""
    noise = np.random.default_rng(7).normal(0.0, 0.001, (300_000, 3))
    index = np.arange(300_000) % len(lidar_frame)
    return replace(
        like(lidar_frame, lidar_frame.points_m[index] + noise), ring=lidar_frame.ring[index]
    )


def no_number_but_valid(lidar_frame: LidarFrame) -> LidarFrame:
    points = lidar_frame.points_m.copy()
    points[::3], points[1::7], points[2::11] = np.nan, np.inf, 3e38
    return replace(lidar_frame, points_m=points)


@dataclass(frozen=True)
class Thrown:
    """Odometry that is disturbed after it was found right: nobody else would notice."""

    poses: Sequence[np.ndarray[tuple[int, int], np.dtype[np.float64]] | None]
    inner: Odometry

    @property
    def version(self) -> str:
        return "thrown@0"

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        for posed, error in zip(self.inner(frames), self.poses, strict=True):
            wrong = posed.odom_from_sensor if error is None else posed.odom_from_sensor @ error
            yield replace(posed, odom_from_sensor=wrong)


def mine(
    frames: Sequence[LidarFrame], odometry: Odometry | None = None
) -> tuple[list[LabelledFrame], list[SceneScore]]:
    parts = Parts(odometry or KissOdometry(), Recorded(), Registration())
    shard = shard_of().model_copy(update={"first_of_log": True, "last_of_log": True})
    mined = list(mine_shard(shard, frames, parts, pipeline_version="0"))
    return [each for one in mined for each in one.scene.frames], [one.score for one in mined]


def falsely_moving(frames: Sequence[LabelledFrame]) -> int:
    """Points that stand still, as the model on the car knows, and are said to move."""
    return sum(int((each.agreements == Agreement.ONLY_PREDICTIVE_DYNAMIC).sum()) for each in frames)


def told(frames: Sequence[LabelledFrame], index: int) -> str:
    """What the health of a frame says, of its pose and of its labels."""
    return f"{frames[index].posed.reason} | {frames[index].predictive.health.reason}"


NOTHING = np.zeros((0, 3))
NO_NUMBERS = np.tile([[np.nan, 1.0, 1.0], [np.inf, 1.0, 1.0], [1.0, -np.inf, np.nan]], (900, 1))

BAD_FRAMES = [
    pytest.param(at_bad(lambda f: like(f, NOTHING)), "no point", id="empty"),
    pytest.param(at_bad(lambda f: like(f, [5.0, 1.0, 0.0])), "1 usable point", id="one point"),
    pytest.param(
        at_bad(lambda f: like(f, np.full((5000, 3), 7.0))), "in 1 place", id="all points equal"
    ),
    pytest.param(
        at_bad(lambda f: like(f, np.full((5000, 3), 7.0), ring=3)), "in 1 place", id="one ring"
    ),
    pytest.param(at_bad(lambda f: like(f, NO_NUMBERS)), "is a return", id="no numbers"),
    pytest.param(
        lambda frames: [*frames[:BAD], *(later(f, by_s=-0.5) for f in frames[BAD:])],
        "time went back by 0.40 s",
        id="time goes back",
    ),
    pytest.param(
        lambda frames: [*frames[:BAD], later(frames[BAD], by_s=-0.1), *frames[BAD + 1 :]],
        "time stood still",
        id="time stands still",
    ),
    pytest.param(
        lambda frames: [*frames[:BAD], *(later(f, by_s=3.0) for f in frames[BAD:])],
        "no frame for 3.10 s",
        id="silence",
    ),
    pytest.param(from_bad(lambda f: beside(f, x_m=6.0, y_m=4.0)), "", id="the car teleports"),
]


@pytest.mark.parametrize(("spoil", "said"), BAD_FRAMES)
def test_a_bad_frame_is_answered_explained_and_got_over(
    spoil: Callable[[Frames], Frames], said: str
) -> None:
    frames = spoil(list(street()))
    mined, scores = mine(frames)
    assert [id(each.posed.frame) for each in mined] == [id(each) for each in frames], "none lost"
    for each in mined:
        assert len(each.predictive.labels) == len(each.posed.frame)
        assert set(np.unique(each.predictive.labels)) <= set(MotionLabel)
    bad = mined[BAD]
    assert bad.posed.odometry is not OdometryState.HEALTHY or bad.predictive.health.blindness
    assert said in told(mined, BAD)
    assert bad.predictive.health.blindness is not None
    assert bad.predictive.health.reason
    assert not (bad.predictive.labels == MotionLabel.DYNAMIC).any()
    assert mined[-1].predictive.health.blindness is None, told(mined, -1)
    assert (mined[-1].predictive.labels == MotionLabel.DYNAMIC).any()
    assert falsely_moving(mined) <= falsely_moving(mine_undisturbed()[0]) + 200
    assert any(score.health is not None and score.health.reason for score in scores)


@cache
def mine_undisturbed() -> tuple[list[LabelledFrame], list[SceneScore]]:
    return mine(street())


def test_the_undisturbed_street_is_judged_and_moves_in_places() -> None:
    frames, scores = mine_undisturbed()
    causes = [each.predictive.health.blindness for each in frames]
    assert causes == [Blindness.NO_PAST] * 4 + [None] * (FRAMES - 4)
    assert sum(int((f.agreements == Agreement.BOTH_DYNAMIC).sum()) for f in frames) > 1000
    for score in scores:
        assert score.health is not None
        assert score.health.pose_jumps == 0
        assert score.health.seen_share is not None
        assert score.health.seen_share > 0.8
        assert 0.0 < score.health.unknown_share < 0.6
    assert scores[0].health is not None
    assert scores[0].health.blind_share == pytest.approx(4 / scores[0].frames, abs=1e-3)
    assert "earlier frames" in scores[0].health.reason


def test_a_missing_frame_changes_nothing_else() -> None:
    frames = [each for i, each in enumerate(street()) if i != BAD]
    mined, _ = mine(frames)
    assert all(each.predictive.health.blindness is None for each in mined[5:])
    assert all(each.posed.odometry is OdometryState.HEALTHY for each in mined)


@pytest.mark.parametrize("spoil", [crowded, no_number_but_valid])
def test_odd_clouds_of_a_good_frame_are_labelled_point_by_point(
    spoil: Callable[[LidarFrame], LidarFrame],
) -> None:
    frames = at_bad(spoil)(list(street()))
    mined, _ = mine(frames)
    answer = mined[BAD].predictive
    assert len(answer.labels) == len(frames[BAD])
    no_return = ~np.isfinite(frames[BAD].points_m).all(axis=1)
    assert (answer.labels[no_return] == MotionLabel.UNKNOWN).all()
    assert (answer.labels[~no_return] == MotionLabel.STATIC).mean() > 0.4
    assert mined[-1].predictive.health.blindness is None


def test_a_cloud_without_rings_is_judged_all_the_same() -> None:
    frames = [replace(each, ring=np.full(len(each), -1, np.int16)) for each in street()]
    mined, scores = mine(frames)
    assert mined[-1].predictive.health.blindness is None
    assert (mined[-1].agreements == Agreement.BOTH_DYNAMIC).sum() > 20
    assert falsely_moving(mined) <= falsely_moving(mine_undisturbed()[0]) + 500
    assert all(score.health is not None for score in scores)


@pytest.mark.parametrize(
    "first", [NOTHING, np.array([[5.0, 1.0, 0.0]]), np.full((5000, 3), 7.0), NO_NUMBERS]
)
@pytest.mark.parametrize("ring", [-1, 3])
def test_a_log_that_begins_badly_is_judged_once_it_is_good(
    first: np.ndarray[tuple[int, int], np.dtype[np.float64]], ring: int
) -> None:
    frames = [like(each, first, ring=ring) if i < 3 else each for i, each in enumerate(street())]
    mined, _ = mine(frames[:12])
    assert [bool(each.predictive.health.reason) for each in mined] == [True] * 7 + [False] * 5
    assert mined[0].posed.odometry is OdometryState.LOST
    assert (mined[-1].predictive.labels == MotionLabel.DYNAMIC).any()


THROWS = {
    "once, 2 m": ([0.0, 0.0, 0.0, 0.0, 2.0, 0.0], 1),
    "for good, 2 m": ([0.0, 0.0, 0.0, 0.0, 2.0, 0.0], FRAMES),
    "once, 0.5 m along": ([0.0, 0.0, 0.0, 0.5, 0.0, 0.0], 1),
    "for good, 0.5 m along": ([0.0, 0.0, 0.0, 0.5, 0.0, 0.0], FRAMES),
    "once, 2 degrees": ([0.0, 0.0, np.radians(2.0), 0.0, 0.0, 0.0], 1),
    "for good, 2 degrees": ([0.0, 0.0, np.radians(2.0), 0.0, 0.0, 0.0], FRAMES),
}


@pytest.mark.parametrize("throw", THROWS)
def test_a_pose_that_is_thrown_unnoticed_gates_and_does_not_flood(throw: str) -> None:
    (x_rad, y_rad, yaw_rad, x_m, y_m, z_m), lasts = THROWS[throw]
    assert (x_rad, y_rad, z_m) == (0.0, 0.0, 0.0)
    error = pose(x_m, y_m, yaw_rad)
    errors = [error if BAD <= i < BAD + lasts else None for i in range(FRAMES)]
    mined, scores = mine(street(), Thrown(errors, KissOdometry()))
    undisturbed, right = mine_undisturbed()
    assert mined[BAD].predictive.health.blindness is Blindness.NO_FIT
    assert "off" in told(mined, BAD)
    assert any(each.predictive.health.blindness is None for each in mined[-3:])
    blind = sum(each.predictive.health.blindness is not None for each in mined)
    assert blind <= 4 + (1 if lasts == 1 else 6)
    assert falsely_moving(mined) <= falsely_moving(undisturbed) + 50
    assert max(s.score for s in scores) <= max(s.score for s in right) + 0.02
