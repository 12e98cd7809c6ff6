"""Cutting scenes: the rule on small worlds, and that the length of shards never shows."""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.contradiction import LabelledFrame, Scene
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.work import Channel, Shard
from workers.ingest.scenes import CutRule, cut_scenes

ANCHOR_NS = 1_700_000_000 * NS_PER_S
LIDAR = Channel(
    topic="/lidar/top",
    message_encoding="cdr",
    schema_name="sensor_msgs/msg/PointCloud2",
    schema_encoding="ros2msg",
    schema_base64="",
    ids=((0, 1),),
)

Cut = tuple[str, tuple[int, ...], bool]


def frame(stamp_ns: int, number: int) -> LabelledFrame:
    """Build a frame of one point that carries its number in the log."""
    one = np.zeros(1, dtype=np.uint8)
    labels = FrameLabels(one.copy(), np.zeros(1, dtype=np.float16))
    lidar_frame = LidarFrame(
        log_id="car/log",
        stamp_ns=stamp_ns,
        points_m=np.full((1, 3), number, dtype=np.float32),
        intensity=np.zeros(1, dtype=np.float32),
        offset_ns=np.zeros(1, dtype=np.int32),
        ring=np.zeros(1, dtype=np.int16),
        valid_mask=np.ones(1, dtype=np.bool_),
    )
    return LabelledFrame(PosedFrame(lidar_frame, np.eye(4)), labels, labels, one)


def log_of(times_s: Sequence[float]) -> list[LabelledFrame]:
    return [frame(ANCHOR_NS + round(t * NS_PER_S), i) for i, t in enumerate(times_s)]


def shards_of(log: Sequence[LabelledFrame], *, shard_s: float, scene_s: float = 2.0) -> list[Shard]:
    """Plan windows as wide as asked over the whole log, each with what it must see around."""
    rule = CutRule.of(scene_s)
    anchor_ns = log[0].stamp_ns
    step_ns = round(shard_s * NS_PER_S)
    first = min((each.stamp_ns - anchor_ns) // step_ns for each in log)
    last = max((each.stamp_ns - anchor_ns) // step_ns for each in log)
    shards = []
    for index in range(first, last + 1):
        start_ns = anchor_ns + index * step_ns
        shards.append(
            Shard(
                log_id="car/log",
                index=index - first,
                lidar=LIDAR,
                anchor_ns=anchor_ns,
                warmup_start_ns=start_ns - max(rule.lookbehind_ns, round(1.2 * NS_PER_S)),
                start_ns=start_ns,
                end_ns=start_ns + step_ns,
                lookahead_end_ns=start_ns + step_ns + rule.lookahead_ns,
                before_lookahead_end_ns=start_ns + rule.lookahead_ns if index > first else 0,
                scene_s=scene_s,
                first_of_log=index == first,
                last_of_log=index == last,
                chunks=(),
                needed_bytes=0,
            )
        )
    return shards


def summary(scene: Scene) -> Cut:
    numbers = tuple(int(each.posed.frame.points_m[0, 0]) for each in scene.frames)
    return scene.scene_id, numbers, scene.too_short


def cut(log: Sequence[LabelledFrame], *, shard_s: float, scene_s: float = 2.0) -> list[Cut]:
    """Cut every shard from the frames that its reader would give it."""
    return [summary(scene) for scene in scenes_of(log, shard_s=shard_s, scene_s=scene_s)]


def sides(scenes: Sequence[Scene]) -> list[tuple[str, list[int], list[int]]]:
    """What lies right before and after each scene, by number."""
    return sorted(
        (
            scene.scene_id,
            [int(each.posed.frame.points_m[0, 0]) for each in scene.before],
            [int(each.posed.frame.points_m[0, 0]) for each in scene.after],
        )
        for scene in scenes
    )


def scenes_of(log: Sequence[LabelledFrame], *, shard_s: float, scene_s: float = 2.0) -> list[Scene]:
    return [
        scene
        for shard in shards_of(log, shard_s=shard_s, scene_s=scene_s)
        for scene in cut_scenes(
            shard,
            (
                each
                for each in log
                if shard.warmup_start_ns <= each.stamp_ns < shard.lookahead_end_ns
            ),
        )
    ]


def lengths(cuts: Sequence[Cut]) -> list[tuple[int, bool]]:
    return [(len(numbers), too_short) for _, numbers, too_short in cuts]


def at_10_hz(start_s: float, end_s: float) -> list[float]:
    return [start_s + i / 10 for i in range(round((end_s - start_s) * 10))]


def test_a_steady_log_is_cut_into_the_cells_of_its_grid() -> None:
    cuts = cut(log_of(at_10_hz(0, 6)), shard_s=20)
    assert lengths(cuts) == [(20, False), (20, False), (20, False)]
    assert cuts[1][0] == f"car/log/lidar.top/{ANCHOR_NS + 2 * NS_PER_S}"


def test_a_last_piece_under_a_second_joins_the_scene_before_it() -> None:
    assert lengths(cut(log_of(at_10_hz(0, 4.7)), shard_s=20)) == [(20, False), (27, False)]


def test_a_last_piece_of_a_second_stands_alone() -> None:
    assert lengths(cut(log_of(at_10_hz(0, 5.1)), shard_s=20)) == [
        (20, False),
        (20, False),
        (11, False),
    ]


def test_a_gap_over_half_a_second_ends_a_scene_inside_its_cell() -> None:
    times_s = at_10_hz(0, 1.2) + at_10_hz(1.8, 6)
    assert lengths(cut(log_of(times_s), shard_s=20)) == [
        (12, False),
        (2, True),
        (20, False),
        (20, False),
    ]


def test_half_a_second_of_silence_is_no_gap() -> None:
    assert lengths(cut(log_of([*at_10_hz(0, 0.8), 1.2, 1.7]), shard_s=20)) == [(10, False)]


def test_a_short_piece_between_gaps_stands_alone_and_too_short() -> None:
    times_s = at_10_hz(0, 2) + at_10_hz(2.8, 3.2) + at_10_hz(4, 6)
    assert lengths(cut(log_of(times_s), shard_s=20)) == [(20, False), (4, True), (20, False)]


def test_a_short_last_piece_after_a_gap_does_not_join() -> None:
    times_s = at_10_hz(0, 3.3) + at_10_hz(4, 4.6)
    assert lengths(cut(log_of(times_s), shard_s=20)) == [(20, False), (13, False), (6, True)]


def test_two_short_pieces_that_meet_at_a_cell_make_one_scene_long_enough() -> None:
    times_s = at_10_hz(0, 0.6) + at_10_hz(1.4, 2.8) + at_10_hz(4, 6)
    assert lengths(cut(log_of(times_s), shard_s=20)) == [(6, True), (14, False), (20, False)]


@pytest.mark.parametrize("frames", [1, 2, 9])
def test_a_log_too_short_to_judge_is_one_scene_that_says_so(frames: int) -> None:
    assert lengths(cut(log_of(at_10_hz(0, frames / 10)), shard_s=20)) == [(frames, True)]


def test_a_jump_back_in_time_ends_a_scene_and_ids_stay_unique() -> None:
    times_s = at_10_hz(0, 4) + at_10_hz(2, 6)
    cuts = cut(log_of(times_s), shard_s=20)
    assert lengths(cuts) == [(20, False)] * 4
    start_ns = ANCHOR_NS + 2 * NS_PER_S
    assert [scene_id.split("/")[-1] for scene_id, _, _ in cuts[1:3]] == [
        f"{start_ns}",
        f"{start_ns}-2",
    ]


def test_a_repeated_frame_neither_ends_a_scene_nor_is_dropped() -> None:
    times_s = at_10_hz(0, 1) + at_10_hz(0.9, 2)
    assert lengths(cut(log_of(times_s), shard_s=20)) == [(21, False)]


def test_warm_up_and_lookahead_frames_are_in_no_scene() -> None:
    log = log_of(at_10_hz(0, 12))
    shard = shards_of(log, shard_s=4)[1]
    scenes = list(cut_scenes(shard, log[20:100]))
    assert [summary(scene)[1] for scene in scenes] == [
        tuple(range(40, 60)),
        tuple(range(60, 80)),
    ]


def test_a_short_piece_that_the_shard_before_cannot_see_to_its_end_stays_where_it_is() -> None:
    log = log_of(at_10_hz(0, 2.6))
    before, after = shards_of(log, shard_s=2)
    before = before.model_copy(update={"lookahead_end_ns": before.end_ns})
    after = after.model_copy(update={"before_lookahead_end_ns": before.end_ns})
    cuts = [summary(scene) for scene in cut_scenes(before, log[:20])]
    cuts += [summary(scene) for scene in cut_scenes(after, log[8:])]
    assert lengths(cuts) == [(20, False), (6, True)]


def steady(_: np.random.Generator) -> float:
    return 0.1


def jittery(rng: np.random.Generator) -> float:
    return float(rng.choice((0.1, 0.1, 0.1, 0.0, 0.3, 0.499, 0.5, 0.501, 0.7, 1.9, 2.5)))


def gappy(rng: np.random.Generator) -> float:
    return 0.1 if rng.random() < 0.9 else rng.uniform(0.05, 5.0)


def slow(rng: np.random.Generator) -> float:
    return rng.uniform(0.3, 0.6)


def rewinding(rng: np.random.Generator) -> float:
    return 0.1 if rng.random() < 0.97 else -rng.uniform(0.05, 6.0)


@pytest.mark.parametrize("step", [steady, jittery, gappy, slow, rewinding])
@pytest.mark.parametrize("scene_s", [2.0, 0.8, 5.0])
def test_scenes_are_the_same_for_any_length_of_shards(
    step: Callable[[np.random.Generator], float], scene_s: float
) -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        times_s = [0.0]
        while len(times_s) < 150:
            times_s.append(round(times_s[-1] + step(rng), 3))
        log = log_of(times_s)
        whole_s = scene_s * math.ceil((max(times_s) - min(times_s)) / scene_s + 2)
        whole = cut(log, shard_s=whole_s, scene_s=scene_s)
        assert sorted(n for _, numbers, _ in whole for n in numbers) == list(range(len(log)))
        assert len({scene_id for scene_id, _, _ in whole}) == len(whole)
        for cells in (1, 2, 3, 10):
            parts = cut(log, shard_s=cells * scene_s, scene_s=scene_s)
            assert sorted(parts) == sorted(whole), (seed, cells)


def test_what_lies_right_before_and_after_a_scene_goes_with_it_but_for_gaps() -> None:
    log = log_of([*at_10_hz(0, 4), *at_10_hz(5, 8)])
    told = [each[1:] for each in sides(scenes_of(log, shard_s=20))]
    # gaps and the ends of the log have nothing beyond them
    assert told[:2] == [([], [*range(20, 30)]), ([*range(10, 20)], [])]
    assert told[2][0] == told[-1][1] == []


@pytest.mark.parametrize("step", [steady, jittery, gappy])
@pytest.mark.parametrize("scene_s", [2.0, 0.8])
def test_what_lies_beside_scenes_is_the_same_for_any_length_of_shards(
    step: Callable[[np.random.Generator], float], scene_s: float
) -> None:
    rng = np.random.default_rng(5)
    times_s = [0.0]
    while len(times_s) < 150:
        times_s.append(round(times_s[-1] + step(rng), 3))
    log = log_of(times_s)
    whole_s = scene_s * math.ceil(max(times_s) / scene_s + 2)
    whole = sides(scenes_of(log, shard_s=whole_s, scene_s=scene_s))
    assert any(before or after for _, before, after in whole)
    for cells in (1, 2, 3, 10):
        parts = sides(scenes_of(log, shard_s=cells * scene_s, scene_s=scene_s))
        assert parts == whole, cells


@pytest.mark.parametrize("step", [jittery, gappy, slow])
def test_no_frame_is_lost_or_repeated_however_far_shards_look_ahead(
    step: Callable[[np.random.Generator], float],
) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        times_s = [0.0]
        while len(times_s) < 80:
            times_s.append(round(times_s[-1] + step(rng), 3))
        log = log_of(times_s)
        seen_until_ns = 0
        numbers: list[int] = []
        for planned in shards_of(log, shard_s=2):
            shard = planned.model_copy(
                update={
                    "before_lookahead_end_ns": seen_until_ns,
                    "lookahead_end_ns": planned.end_ns + round(rng.uniform(0, 2.2) * NS_PER_S),
                }
            )
            seen_until_ns = shard.lookahead_end_ns
            visible = [
                each
                for each in log
                if shard.warmup_start_ns <= each.stamp_ns < shard.lookahead_end_ns
            ]
            numbers += [n for scene in cut_scenes(shard, visible) for n in summary(scene)[1]]
        assert sorted(numbers) == list(range(len(log))), seed


def test_cutting_holds_no_more_than_two_scenes() -> None:
    log = log_of(at_10_hz(0, 60))
    taken = 0

    def counted() -> Iterator[LabelledFrame]:
        nonlocal taken
        for each in log:
            taken += 1
            yield each

    for done, _ in enumerate(cut_scenes(shards_of(log, shard_s=60)[0], counted()), start=1):
        assert taken <= 20 * done + 21
