from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.free_space import Votes
from workers.lidar.beam_table import BeamTable
from workers.points.clusters import from_labels
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.occlusion_fragments import merge_fragments
from workers.selfsupervised.single_voxels import assign_single_voxels
from workers.selfsupervised.tracker import Tracked, Tracker

PERIOD_NS = 100_000_000
CENTRE_M = np.zeros(3, np.float32)
TABLE = BeamTable(np.arange(-0.3, 0.1, 0.004, dtype=np.float32), np.zeros(3), max_gap=0.03)
"""Beams a voxel apart at 37 m, and 0.3 m at 75 m."""


@dataclass(frozen=True)
class Thing:
    """A block of voxels, and what one frame finds out about it."""

    at: tuple[float, float]
    size_m: tuple[float, float, float] = (3.0, 1.5, 1.2)
    velocity: tuple[float, float] = (0.0, 0.0)
    proved: bool = False
    unconfirmed: bool = False
    still: bool = False
    occupied: int = 0
    up_m: float = 0.0


def voxels_of(thing: Thing) -> NDArray[np.float32]:
    axes = [np.arange(0.0, side, 0.3) for side in thing.size_m]
    block = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    placed: NDArray[np.float32] = (block + np.array([*thing.at, thing.up_m])).astype(np.float32)
    return placed


def world(*things: Thing) -> tuple[NDArray[np.float32], ClusterMotions, Votes]:
    voxels = [voxels_of(thing) for thing in things]
    sizes = [len(block) for block in voxels]
    labels = np.repeat(np.arange(len(things)), sizes).astype(np.int32)
    found = ClusterMotions(
        clusters=from_labels(labels),
        registered=np.array([thing.proved for thing in things]),
        seen_through=np.zeros(len(things), np.bool_),
        unconfirmed=np.array([thing.unconfirmed for thing in things]),
        still=np.array([thing.still for thing in things]),
        velocity_m_per_s=np.array([[*t.velocity, 0.0] for t in things], np.float32),
        near_velocity_m_per_s=np.zeros((len(things), 3), np.float32),
        extent_m=np.array([max(t.size_m[:2]) for t in things], np.float32),
    )
    occupied = np.repeat([thing.occupied for thing in things], sizes).astype(np.int16)
    return (
        np.concatenate(voxels),
        found,
        Votes(np.zeros_like(occupied), occupied, np.zeros_like(occupied)),
    )


def evidence_of(votes: Votes) -> FreeSpaceEvidence:
    """Votes of a sensor that lies on the road."""
    nothing = Votes(*np.zeros((3, len(votes.free)), np.int16))
    return FreeSpaceEvidence(
        votes=votes,
        after=nothing,
        near=np.zeros(len(votes.free), np.int8),
        far=np.zeros(len(votes.free), np.int8),
        image=np.zeros((0, 0), np.float32),
        table=TABLE,
        sensor_height_m=0.0,
        beams_from_odom=np.eye(4),
    )


class Frames:
    """Frames a tenth of a second apart, given to one tracker."""

    def __init__(self) -> None:
        self.tracker, self.now_ns = Tracker(), PERIOD_NS

    def see(self, *things: Thing, after_ns: int = PERIOD_NS) -> Tracked:
        self.now_ns += after_ns
        points_m, found, votes = world(*things)
        return self.tracker.update(
            points_m, found, votes, centre_m=CENTRE_M, now_ns=self.now_ns, table=TABLE
        )


def test_what_was_proved_to_move_still_moves_in_a_frame_that_proves_nothing() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(10.0, 0.0), proved=True))
    seen = frames.see(Thing(at=(6.0, 0.0)))
    assert seen.dynamic.tolist() == [True]
    assert seen.velocity_m_per_s[0].tolist() == pytest.approx([10.0, 0.0, 0.0])


def test_one_proof_lasts_for_one_frame_and_two_for_three() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(10.0, 0.0), proved=True))
    after_one = [frames.see(Thing(at=(x, 0.0))).dynamic[0] for x in (6.0, 7.0)]
    assert after_one == [True, False]

    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(10.0, 0.0), proved=True))
    frames.see(Thing(at=(6.0, 0.0), velocity=(10.0, 0.0), proved=True))
    after_two = [frames.see(Thing(at=(x, 0.0))).dynamic[0] for x in (7.0, 8.0, 9.0)]
    assert after_two == [True, True, False]


def test_a_score_fades_by_time_not_by_frames() -> None:
    at_10_hz, at_5_hz = Frames(), Frames()
    for frames in (at_10_hz, at_5_hz):
        for _ in range(2):
            frames.see(Thing(at=(5.0, 0.0), proved=True))
    at_10_hz.see(Thing(at=(5.0, 0.0)))
    at_10_hz.see(Thing(at=(5.0, 0.0)))
    at_5_hz.see(Thing(at=(5.0, 0.0)), after_ns=2 * PERIOD_NS)
    assert (
        at_10_hz.see(Thing(at=(5.0, 0.0))).dynamic.tolist()
        == at_5_hz.see(Thing(at=(5.0, 0.0))).dynamic.tolist()
    )


def test_a_handful_of_voxels_must_be_proved_twice() -> None:
    frames, tiny = Frames(), (0.6, 0.6, 0.6)
    first = frames.see(Thing(at=(5.0, 0.0), size_m=tiny, velocity=(2.0, 0.0), proved=True))
    second = frames.see(Thing(at=(5.2, 0.0), size_m=tiny, velocity=(2.0, 0.0), proved=True))
    assert (first.dynamic[0], second.dynamic[0]) == (False, True)


@pytest.mark.parametrize(("away_m", "at_once"), [(5.0, False), (60.0, True)])
def test_as_many_voxels_are_a_piece_of_something_near_and_the_whole_of_something_far(
    away_m: float, *, at_once: bool
) -> None:
    frames, piece = Frames(), (0.6, 0.6, 0.8)
    first = frames.see(Thing(at=(away_m, 0.0), size_m=piece, velocity=(2.0, 0.0), proved=True))
    again = (away_m + 0.2, 0.0)
    second = frames.see(Thing(at=again, size_m=piece, velocity=(2.0, 0.0), proved=True))
    assert (first.dynamic[0], second.dynamic[0]) == (at_once, True)


def test_what_is_proved_to_move_where_something_was_before_must_be_proved_twice() -> None:
    frames = Frames()
    first = frames.see(Thing(at=(5.0, 0.0), velocity=(1.0, 0.0), proved=True, occupied=2))
    second = frames.see(Thing(at=(5.1, 0.0), velocity=(1.0, 0.0), proved=True, occupied=2))
    assert (first.dynamic[0], second.dynamic[0]) == (False, True)


@pytest.mark.parametrize(("breadth_m", "at_once"), [(0.1, False), (0.6, True)])
def test_what_is_a_line_from_above_must_be_proved_twice(breadth_m: float, *, at_once: bool) -> None:
    frames, side = Frames(), (4.5, breadth_m, 1.2)
    first = frames.see(Thing(at=(20.0, 9.0), size_m=side, velocity=(8.0, 0.0), proved=True))
    second = frames.see(Thing(at=(20.8, 9.0), size_m=side, velocity=(8.0, 0.0), proved=True))
    assert (first.dynamic[0], second.dynamic[0]) == (at_once, True)


def test_what_stands_where_a_mover_came_from_inherits_nothing() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(20.0, 0.0), proved=True))
    seen = frames.see(Thing(at=(5.0, 3.0)), Thing(at=(7.0, 0.0)))
    assert seen.dynamic.tolist() == [False, True]


def test_a_piece_that_was_taken_for_a_mover_does_not_move_the_whole() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), size_m=(1.0, 1.5, 1.2), velocity=(3.0, 0.0), proved=True))
    seen = frames.see(Thing(at=(5.0, 0.0), size_m=(3.0, 1.5, 1.2)))
    assert seen.dynamic.tolist() == [False]


def test_a_thing_that_is_seen_to_stand_loses_one_proof_at_once() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(1.0, 0.0), proved=True))
    seen = frames.see(Thing(at=(5.1, 0.0), still=True, occupied=5))
    assert seen.dynamic.tolist() == [False]


def test_a_motion_like_the_one_before_is_a_hint_even_where_free_space_is_silent() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(10.0, 0.0), proved=True))
    going_on = Thing(at=(6.0, 0.0), velocity=(10.5, 0.0), unconfirmed=True)
    assert frames.see(going_on).dynamic.tolist() == [True]
    assert frames.see(
        Thing(at=(7.05, 0.0), velocity=(10.5, 0.0), unconfirmed=True)
    ).dynamic.tolist() == [True]


def test_a_cleared_tracker_knows_nothing() -> None:
    frames = Frames()
    frames.see(Thing(at=(5.0, 0.0), velocity=(10.0, 0.0), proved=True))
    frames.tracker.clear()
    assert frames.see(Thing(at=(6.0, 0.0))).dynamic.tolist() == [False]


MOVER = Thing(at=(5.0, 0.0), velocity=(10.0, 0.0), proved=True)
SMALL_M = (1.5, 1.2, 1.2)


def tracked_as(dynamic: list[bool], *, confirmed: list[bool]) -> Tracked:
    still = np.zeros((len(dynamic), 3), np.float32)
    return Tracked(np.array(dynamic), np.array(confirmed), still)


def test_what_is_proved_in_two_frames_is_confirmed_and_what_is_proved_once_is_not() -> None:
    frames = Frames()
    once = frames.see(replace(MOVER, size_m=SMALL_M))
    assert (once.dynamic.tolist(), once.confirmed.tolist()) == ([True], [False])
    twice = frames.see(replace(MOVER, size_m=SMALL_M, at=(6.0, 0.0)))
    assert (twice.dynamic.tolist(), twice.confirmed.tolist()) == ([True], [True])


def test_what_is_too_large_to_be_an_error_of_free_space_is_confirmed_at_once() -> None:
    large = Thing(at=(5.0, 0.0), size_m=(4.0, 1.8, 1.5), velocity=(10.0, 0.0), proved=True)
    assert Frames().see(large).confirmed.tolist() == [True]
    standing = Thing(at=(5.0, 0.0), size_m=(4.0, 1.8, 1.5))
    assert Frames().see(standing).confirmed.tolist() == [False]


@pytest.mark.parametrize(
    ("piece", "belongs"),
    [
        pytest.param(Thing(at=(8.1, 0.0), size_m=(0.6, 0.6, 0.6)), True, id="behind its bumper"),
        pytest.param(Thing(at=(10.0, 0.0), size_m=(0.6, 0.6, 0.6)), False, id="farther away"),
        pytest.param(Thing(at=(8.1, 0.0), size_m=(0.6, 0.6, 0.1)), False, id="flat as the road"),
        pytest.param(
            Thing(at=(8.1, 0.0), size_m=(0.6, 0.6, 0.1), up_m=0.9), True, id="flat as a bonnet"
        ),
        pytest.param(Thing(at=(8.1, 0.0), size_m=(3.6, 0.6, 0.6)), False, id="longer than a piece"),
        pytest.param(
            Thing(at=(8.1, 0.0), size_m=(0.6, 0.6, 0.6), occupied=6), False, id="was there before"
        ),
        pytest.param(
            Thing(at=(8.1, 0.0), size_m=(0.6, 0.6, 0.6), still=True, occupied=3),
            False,
            id="fits where it was",
        ),
    ],
)
def test_a_small_piece_beside_a_mover_belongs_to_it_unless_something_speaks_against_it(
    piece: Thing, belongs: bool
) -> None:
    points_m, found, votes = world(MOVER, piece)
    for confirmed in (True, False):
        tracked = tracked_as([True, False], confirmed=[confirmed, False])
        evidence = evidence_of(votes)
        whole = merge_fragments(points_m, found, tracked, evidence, centre_m=CENTRE_M)
        assert whole.dynamic.tolist() == [True, belongs]
        assert whole.confirmed.tolist() == [confirmed, belongs and confirmed]


def test_without_a_mover_no_piece_belongs_to_one() -> None:
    points_m, found, votes = world(Thing(at=(5.0, 0.0)), Thing(at=(8.1, 0.0)))
    tracked = tracked_as([False, False], confirmed=[False, False])
    none = merge_fragments(points_m, found, tracked, evidence_of(votes), centre_m=CENTRE_M)
    assert not none.dynamic.any()
    assert not none.confirmed.any()


@pytest.mark.parametrize(
    ("at", "free", "occupied", "belongs"),
    [
        pytest.param((8.0, 0.0), 0, 0, True, id="as near as the points of one body"),
        pytest.param((8.0, 0.0), 0, 5, False, id="and was there before"),
        pytest.param((8.4, 0.0), 0, 0, False, id="farther away"),
        pytest.param((8.4, 0.0), 3, 0, True, id="but its place was seen through"),
        pytest.param((9.0, 0.0), 3, 0, False, id="farther than the width of a gap in a car"),
    ],
)
def test_a_speck_that_no_cluster_took_belongs_to_the_mover_beside_it(
    at: tuple[float, float], free: int, occupied: int, belongs: bool
) -> None:
    points_m, found, votes = world(MOVER)
    points_m = np.concatenate([points_m, np.array([[*at, 0.6]], np.float32)])
    found = replace(found, clusters=from_labels(np.append(found.clusters.of_point, -1)))
    votes = Votes(
        np.append(votes.free, free),
        np.append(votes.occupied, occupied),
        np.append(votes.free_if_tall, 0),
    )

    def owner(*, moves: bool) -> int:
        given = assign_single_voxels(points_m, found, np.array([moves]), votes, centre_m=CENTRE_M)
        assert given.clusters.of_point[:-1].tolist() == found.clusters.of_point[:-1].tolist()
        return int(given.clusters.of_point[-1])

    assert owner(moves=True) == (0 if belongs else -1)
    assert owner(moves=False) == -1
