from itertools import product

import numpy as np
import pytest

from schemas.overlay import Overlay
from schemas.score import Reason, SceneScore
from service.pictures.reasons import lines_of
from service.pictures.scene import draw_scene
from service.pictures.style import font, wrap
from tests.labelled_worlds import Thing, labelled_scene
from tests.unit.service.test_picture import DYNAMIC, PHANTOM, STATIC, WALL, mined_scene

LONG = (
    "supervised calls car static, but it moves at 10.0 m/s, 20 m behind, for 2.0 s: supervised "
    "wrong, 79 %; for: agreed dynamic earlier; against: witness label static, clutter of like "
    "contradictions"
)
ODOMETRY = "odometry degraded (a second registration is 0.15 m off over 0.1 s) in 55% of the frames"
BLIND = "self-supervised stream blind in {} of the frames (poses went where no car goes)"


@pytest.fixture(scope="module")
def crowded() -> tuple[SceneScore, Overlay]:
    parked = [Thing((12, 6 + 6 * i, 0), DYNAMIC, STATIC, points=400) for i in range(5)]
    return mined_scene(labelled_scene([WALL, PHANTOM, *parked], frames=12))


def _drawn(crowded: tuple[SceneScore, Overlay], *headlines: str) -> bytes:
    score, overlay = crowded
    reasons = tuple(
        Reason(headline=each, track_id=number if each == LONG else None)
        for number, each in enumerate(headlines)
    )
    return draw_scene(score.model_copy(update={"reasons": reasons}), overlay).tobytes()


def test_what_held_a_score_down_has_room_whatever_stands_before_it(
    crowded: tuple[SceneScore, Overlay],
) -> None:
    before = (*[LONG] * 5, ODOMETRY)
    few, many = (_drawn(crowded, *before, BLIND.format(share)) for share in ("10%", "90%"))
    assert few != many


def test_that_tracks_are_left_out_is_said_with_how_many(
    crowded: tuple[SceneScore, Overlay],
) -> None:
    assert len(crowded[0].tracks) >= 6
    five, six = (_drawn(crowded, *[LONG] * count, ODOMETRY) for count in (5, 6))
    assert five != six


def test_what_a_recorded_odometry_is_worth_is_no_track(
    crowded: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = crowded
    told = "recorded odometry not believed: 90% of the last 50 steps differ"
    picture, other = (
        draw_scene(score.model_copy(update={"reasons": (Reason(headline=each),)}), overlay)
        for each in (told, "odometry" + told[17:])
    )
    marks = [np.asarray(each)[700:1120, 1176:1190] for each in (picture, other)]
    assert (marks[0] == marks[1]).all()


def test_a_long_reason_ends_with_a_whole_remark_and_never_with_an_empty_heading() -> None:
    ends = set[str]()
    for width_px in range(180, 900, 3):
        for most in (1, 2, 3):
            *_, last = wrap(LONG, width_px, 16, max_lines=most)
            if last.endswith("..."):
                assert not last.endswith((":...", ",...", ";..."))
                assert all(word.strip(".,;") in LONG for word in last.split())
                ends.add(last.removesuffix("...").rpartition("; ")[2])
    assert "against: witness label static" in ends, "the first of two remarks is whole"


@pytest.mark.parametrize(
    ("text", "room_for", "cut"),
    [
        ("errs (79%; for: far, low and thin)", "errs (79%; for:...", "errs (79%..."),
        (
            "errs (79%; for: far, low and thin)",
            "errs (79%; for: far, low...",
            "errs (79%; for: far...",
        ),
        ("for: both see it move before", "for: both see...", "for: both see..."),
        ("against: all", "against:...", "..."),
    ],
)
def test_what_is_cut_within_a_line(text: str, room_for: str, cut: str) -> None:
    assert wrap(text, font(16).getlength(room_for), 16, max_lines=1) == [cut]


@pytest.mark.parametrize(
    ("wanted", "gates", "room", "lines"),
    [
        ([4, 4], 0, 11, [4, 4]),
        ([4, 3, 3], 1, 7, [3, 2, 2]),
        ([4, 4, 4, 4, 4, 2], 1, 9, [2, 2, 2, 0, 0, 2]),  # the ninth says "and 2 more"
        ([4, 4, 2, 2], 2, 6, [3, 1, 1, 1]),
        ([1, 1, 1], 0, 3, [1, 1, 1]),
        ([3], 1, 9, [3]),
        ([], 0, 9, []),
    ],
)
def test_lines_go_to_gates_then_to_tracks_then_to_the_first(
    wanted: list[int], gates: int, room: int, lines: list[int]
) -> None:
    assert lines_of(wanted, gates=gates, room=room) == lines


def test_gates_and_the_strongest_track_are_always_told_and_no_line_is_beyond_the_room() -> None:
    for tracks, gates, room, full in product(range(6), range(5), range(6, 14), range(1, 6)):
        lines = lines_of([full] * (tracks + gates), gates=gates, room=room)
        assert all(lines[tracks:])
        assert all(lines[: min(tracks, 1)])
        assert sum(lines) + (0 in lines) <= room
