"""Twins: neighbours that show the same thing as a better scene which is no twin itself."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.contradiction import ContradictionKind, Place, TrackRecord
from schemas.surroundings import ScenePlace
from service.curation.ranking import Neighbour
from service.curation.twins import ShownScene, Twins, is_in_place
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


MUNICH = (48.137, 11.575)


def drove_past(
    day: int,
    *tracks: TrackRecord,
    east_m: float = 0.0,
    heading_rad: float | None = 0.1,
    log_id: str = "",
    **changes: Any,
) -> ShownScene:
    """A scene of a drive past a place, on another day each; its odom space is turned by the day."""
    start_ns = day * 86_400 * NS_PER_S
    longitude = MUNICH[1] + east_m / 111_320.0 / math.cos(math.radians(MUNICH[0]))
    fields: dict[str, Any] = {
        "latitude_deg": MUNICH[0],
        "longitude_deg": longitude,
        "odom_m": (0.0, 0.0),
        "odom_yaw_rad": float(day),
        "heading_rad": heading_rad,
    }
    place = ScenePlace(**(fields | changes))
    at = Neighbour(f"{log_id or f'day-{day}'}/lidar/{start_ns}", start_ns, start_ns + 2 * NS_PER_S)
    return ShownScene(at, f"day {day}", 20.0, tracks, place)


def standing(east_m: float, north_m: float = 0.0, *, day: int, **changes: Any) -> TrackRecord:
    """A thing that stands some metres from the car, in the odom space of that day."""
    cos, sin = math.cos(-day), math.sin(-day)
    at: Place = (cos * east_m - sin * north_m, sin * east_m + cos * north_m, 0.0)
    return thing(at, **changes)


def twins_by_place(*scenes: ShownScene) -> dict[str, str | None]:
    finder = Twins()
    found = {each.at.scene_id: finder.twin_of(each, ()) for each in scenes}
    return {name.partition("/")[0]: twin and twin.partition("/")[0] for name, twin in found.items()}


def test_what_stands_at_the_same_place_on_another_day_is_a_twin() -> None:
    first = drove_past(1, standing(20.0, 5.0, day=1))
    again = drove_past(3, standing(15.0, 5.0, day=3), east_m=7.0)
    assert twins_by_place(first, again) == {"day-1": None, "day-3": "day-1"}
    assert is_in_place(again.at.scene_id, first.at.scene_id)


@pytest.mark.parametrize(
    "again",
    [
        pytest.param(drove_past(3, standing(40.0, day=3)), id="elsewhere"),
        pytest.param(drove_past(3, standing(20.0, day=3), east_m=300.0), id="another street"),
        pytest.param(drove_past(3, standing(20.0, day=3, class_name="bus")), id="another class"),
        pytest.param(
            drove_past(3, standing(20.0, day=3, kind=ContradictionKind.ONLY_SEMANTIC_DYNAMIC)),
            id="another kind",
        ),
        pytest.param(drove_past(3, standing(20.0, day=3, speed_m_per_s=3.0)), id="it drives"),
        pytest.param(
            drove_past(3, standing(20.0, day=3, last_odom_m=(3.0, 3.0, 0.0))), id="it went"
        ),
        pytest.param(drove_past(3, standing(20.0, day=3), heading_rad=3.0), id="other direction"),
        pytest.param(drove_past(3, standing(20.0, day=3), heading_rad=None), id="no direction"),
        pytest.param(drove_past(3, standing(20.0, day=3), odom_yaw_rad=None), id="not turned"),
        pytest.param(
            drove_past(
                *(3, standing(20.0, day=3)),
                frame="map",
                x_m=1.0,
                y_m=2.0,
                latitude_deg=None,
                longitude_deg=None,
            ),
            id="another frame",
        ),
        pytest.param(
            drove_past(3, standing(20.0, day=3), thing((90.0, 0.0, 0.0), strength=0.4)),
            id="shows more",
        ),
        pytest.param(replace(drove_past(3, standing(20.0, day=3)), place=None), id="no place"),
    ],
)
def test_of_another_drive_only_the_same_standing_thing_is_a_twin(again: ShownScene) -> None:
    first = drove_past(1, standing(20.0, day=1))
    assert set(twins_by_place(first, again).values()) == {None}


def test_a_drive_is_no_twin_of_itself_in_place_until_it_comes_back() -> None:
    first, soon, later = (
        replace(
            drove_past(1, standing(20.0, day=1)),
            at=Neighbour(
                f"log/lidar/{begins_s * NS_PER_S}", begins_s * NS_PER_S, begins_s * NS_PER_S
            ),
        )
        for begins_s in (0, 60, 400)
    )
    finder = Twins()
    found = [finder.twin_of(each, ()) for each in (first, soon, later)]
    assert found == [None, None, "log/lidar/0"]


def test_a_twin_in_place_is_nobodys_original() -> None:
    chain = [drove_past(day, standing(20.0 + 5 * day, day=day)) for day in range(1, 4)]
    assert twins_by_place(*chain) == {"day-1": None, "day-2": "day-1", "day-3": None}


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
