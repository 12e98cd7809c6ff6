"""Twins: neighbours that show the same thing as a better scene which is no twin itself."""

from collections.abc import Sequence
from typing import Any

import pytest

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.contradiction import ContradictionKind, Place, TrackRecord
from service.curation.ranking import Neighbour
from service.curation.twins import ShownScene, Twins
from tests.factories import track_record

STEP_NS = 2 * NS_PER_S


def at(number: int) -> Neighbour:
    """The scene of a 2 s cell, 1.9 s long."""
    return Neighbour(f"s{number}", number * STEP_NS, number * STEP_NS + 19 * NS_PER_S // 10)


def thing(
    place: Place = (10.0, 0.0, 0.0),
    *,
    to: Place | None = None,
    number: int = 0,
    strength: float = 0.5,
    wrong: Wrong = Wrong.SUPERVISED,
    **changes: Any,
) -> TrackRecord:
    """A track over all of the scene of a cell."""
    here = at(number)
    fields: dict[str, Any] = {
        "strength": strength,
        "first_ns": here.start_ns,
        "last_ns": here.end_ns,
        "speed_m_per_s": 0.0,
        "first_odom_m": place,
        "last_odom_m": to or place,
        "attribution": Attribution(
            wrong=wrong, supervised=0.6, selfsupervised=0.4, both=0.0, neither=0.0
        ),
    }
    return track_record(**(fields | changes))


def shown(
    number: int, *tracks: TrackRecord, odom: str = "shard 0", driven_m: float = 0.0
) -> ShownScene:
    return ShownScene(at(number), odom, driven_m, tracks)


def twins(scenes: Sequence[ShownScene]) -> dict[str, str | None]:
    """Find the twins of scenes in the order given, each among the cells next to its own."""
    finder = Twins()
    known = {scene.at.start_ns: scene.at for scene in scenes}
    return {
        scene.at.scene_id: finder.twin_of(
            scene, (known.get(scene.at.start_ns - STEP_NS), known.get(scene.at.start_ns + STEP_NS))
        )
        for scene in scenes
    }


def test_a_neighbour_that_shows_the_same_thing_is_a_twin() -> None:
    assert twins([shown(1, thing(number=1)), shown(0, thing())]) == {"s1": None, "s0": "s1"}


def test_the_neighbour_of_a_twin_is_none() -> None:
    slope = [shown(number, thing(number=number)) for number in range(4)]
    assert twins(slope) == {"s0": None, "s1": "s0", "s2": None, "s3": "s2"}


def test_of_two_neighbours_the_better_one_is_named() -> None:
    best, good = thing(number=2, strength=0.9), thing(strength=0.8)
    between = shown(1, thing(number=1))
    assert twins([shown(2, best), shown(0, good), between])["s1"] == "s2"


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(thing((30.0, 0.0, 0.0), number=1), id="elsewhere"),
        pytest.param(thing(number=1, class_name="bus"), id="another class"),
        pytest.param(
            thing(number=1, kind=ContradictionKind.ONLY_SEMANTIC_DYNAMIC), id="another kind"
        ),
    ],
)
def test_a_neighbour_that_shows_another_thing_is_none(other: TrackRecord) -> None:
    assert set(twins([shown(0, thing()), shown(1, other)]).values()) == {None}


def test_a_mover_is_the_same_where_one_scene_ends_and_the_next_begins() -> None:
    goes = thing((0.0, 0.0, 0.0), to=(19.0, 0.0, 0.0), speed_m_per_s=10.0)
    on = thing((20.0, 0.0, 0.0), to=(39.0, 0.0, 0.0), number=1, speed_m_per_s=10.0)
    back = thing((0.0, 0.0, 0.0), to=(19.0, 0.0, 0.0), number=1, speed_m_per_s=10.0)
    assert twins([shown(0, goes), shown(1, on)])["s1"] == "s0"
    assert twins([shown(1, on), shown(0, goes)])["s0"] == "s1"
    assert twins([shown(0, goes), shown(1, back)])["s1"] is None


def test_a_scene_with_a_further_weighty_reason_is_no_twin() -> None:
    best = shown(0, thing(strength=0.9))
    same, faint, new = (
        thing(number=1, strength=0.8),
        thing((50.0, 0.0, 0.0), number=1, strength=0.3),
        thing((50.0, 0.0, 0.0), number=1, strength=0.5),
    )
    assert twins([best, shown(1, same, faint)])["s1"] == "s0"
    assert twins([best, shown(1, same, new)])["s1"] is None


def test_what_is_no_reason_does_not_make_a_scene_distinct() -> None:
    right = thing((50.0, 0.0, 0.0), number=1, strength=0.8, wrong=Wrong.SELFSUPERVISED)
    both = shown(1, right, thing(number=1, strength=0.7))
    assert twins([shown(0, thing(strength=0.9)), both])["s1"] == "s0"
    assert twins([shown(0, thing()), shown(1, right)])["s1"] is None, "it has no reason itself"


@pytest.mark.parametrize(("driven_m", "twin"), [(0.0, None), (10.0, "s0")])
def test_between_shards_the_way_of_the_sensor_is_allowed_for(
    driven_m: float, twin: str | None
) -> None:
    near, far = (
        track_record(
            strongest=track_record().strongest.model_copy(update={"centre_m": (x, 0.0, 0.0)}),
            speed_m_per_s=0.0,
        )
        for x in (0.0, 20.0)
    )
    scenes = [
        shown(0, near, driven_m=driven_m),
        shown(1, far, odom="shard 1", driven_m=driven_m),
    ]
    assert twins(scenes)["s1"] == twin


def test_a_pause_of_a_second_makes_scenes_distinct() -> None:
    finder, late = Twins(), Neighbour("late", 29 * NS_PER_S // 10, 5 * NS_PER_S)
    assert finder.twin_of(shown(0, thing()), ()) is None
    assert finder.twin_of(ShownScene(late, "shard 0", 0.0, (thing(number=1),)), (at(0),)) is None
