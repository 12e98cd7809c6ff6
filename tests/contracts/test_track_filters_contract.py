"""Filters of the listing by kind, class, attribution and range of a track, on any database."""

import random
from typing import Any

import pytest
from sqlalchemy import select

from schemas.attribution import Wrong
from schemas.events import TrackSummary
from service.curation.listing import ScenesRequest, passes
from service.store.tables import LISTED_TRACKS
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World
from tests.contracts.store_contract import StoreContract
from tests.contracts.test_listing_contract import ask, attributed, commit, found, numbers, scene
from tests.factories import track_at


class TrackFiltersContract(StoreContract):
    def test_a_filter_by_range_is_passed_by_one_strong_track(self, world: World) -> None:
        near, far, weak = track_at(12.4), track_at(79.99), track_at(40.0, strength=0.01)
        commit(
            world,
            scene(0, 0.9, tracks=(near, far, weak)),
            scene(1, 0.8, tracks=(track_at(30.0, class_name="bus"),)),
            scene(2, 0.7, tracks=(track_at(30.01),)),
            scene(3, 0.6, tracks=(weak,)),
            scene(4, 0.5, tracks=()),
            scene(5, 0.4, tracks=(track_at(300.0),)),
            scene(6, 0.3, tracks=(track_at(0.0),)),
            scene(7, 0.2, tracks=(track_at(63.0),)),
            scene(8, 0.1, tracks=(track_at(63.01),)),
        )
        assert found(world, within_m=30) == [0, 1, 6]
        assert found(world, beyond_m=30) == [0, 2, 5, 7, 8]
        assert found(world, beyond_m=12, within_m=13) == [0]
        assert found(world, beyond_m=30, within_m=79) == [2, 7, 8], "one track is between both"
        assert found(world, beyond_m=30, within_m=80) == [0, 2, 7, 8]
        assert found(world, within_m=63, beyond_m=62) == [7]
        assert found(world, within_m=64, beyond_m=63) == [8]
        assert found(world, beyond_m=125) == [5]
        assert found(world, within_m=1) == [6]
        assert found(world, beyond_m=0) == [0, 1, 2, 5, 6, 7, 8], "some strong track"
        assert found(world, within_m=125) == [0, 1, 2, 6, 7, 8]
        assert found(world, within_m=30, class_name="bus") == [1]
        assert found(world, within_m=30, min_score=0.5) == [0, 1]

    def test_filters_of_tracks_are_passed_by_one_track(self, world: World) -> None:
        kinds = ("only_semantic_dynamic", "only_predictive_dynamic")
        both, neither = attributed(Wrong.BOTH), attributed(Wrong.NEITHER)
        near = track_at(10.0, kind=kinds[0], class_name="bus", attribution=both)
        far = track_at(60.0, kind=kinds[1], class_name="a|b", attribution=neither)
        far_bus = track_at(70.0, kind=kinds[1], class_name="bus")
        commit(
            world,
            scene(0, tracks=(near, far)),
            scene(1, tracks=(far,)),
            scene(2, tracks=(near, far, far_bus)),
            scene(3, tracks=()),
        )
        assert found(world, kind=kinds[0]) == [0, 2]
        assert found(world, kind=kinds[0], within_m=30) == [0, 2]
        assert found(world, kind=kinds[0], beyond_m=30) == []
        assert found(world, kind=kinds[1], beyond_m=30) == [0, 1, 2]
        assert found(world, class_name="bus", beyond_m=30) == [2]
        assert found(world, class_name="a/b", within_m=60) == [0, 1, 2], "as choices name it"
        assert found(world, class_name="a/b", within_m=59) == []
        assert found(world, wrong="both", within_m=10) == [0, 2]
        assert found(world, wrong="neither", within_m=10) == []
        assert found(world, wrong="supervised", within_m=10) == []
        assert found(world, kind=kinds[1], class_name="bus") == [2]
        assert found(world, kind=kinds[0], wrong="neither") == []
        assert found(world, kind=kinds[1], text="/lidar", beyond_m=65) == [2]
        world.listed("b")
        assert found(world) == found(world, kind=kinds[1], beyond_m=30) == []
        with world.store.reading() as connection:
            assert connection.execute(select(LISTED_TRACKS.c.seq)).all() == []
        world.listed("a", "b")
        assert found(world, kind=kinds[1], beyond_m=30) == [0, 1, 2], "as the scenes return"

    def test_a_class_is_found_in_any_case(self, world: World) -> None:
        commit(
            world,
            scene(0, tracks=(track_at(10.0, class_name="Car"),)),
            scene(1, tracks=(track_at(40.0, class_name="car"),)),
            scene(2, tracks=(track_at(10.0, class_name="Cargo"), track_at(10.0, class_name=""))),
            scene(3, tracks=(track_at(10.0, class_name="Fußgänger|ÜBER"),)),
        )
        for name in ("car", "Car", "CAR"):
            assert found(world, class_name=name) == [0, 1]
            assert found(world, class_name=name, within_m=30) == [0]
        assert found(world, class_name="ca") == found(world, class_name="c%r") == []
        assert found(world, class_name="fussgänger/über") == [3]
        assert found(world, class_name="FUßGÄNGER/über", within_m=30) == [3]

    def test_any_filters_of_tracks_pass_what_one_of_the_tracks_passes(self, world: World) -> None:
        dice = random.Random(7)  # noqa: S311 (a test's dice)
        kinds = ("only_semantic_dynamic", "only_predictive_dynamic", "only_witness_dynamic")
        classes, ranges_m = ("car", "bus", ""), (0.0, 4.0, 4.01, 62.9, 63.0, 63.5, 80.2, 130.0)
        scenes = [
            scene(
                number,
                tracks=tuple(
                    track_at(
                        dice.choice(ranges_m),
                        kind=dice.choice(kinds),
                        class_name=dice.choice(classes),
                        attribution=dice.choice([None, attributed(dice.choice(tuple(Wrong)))]),
                        strength=dice.choice([0.5, 0.05, 0.049]),
                    )
                    for _ in range(dice.randint(0, 4))
                ),
            )
            for number in range(60)
        ]
        commit(world, *scenes)
        for _ in range(80):
            asked: dict[str, Any] = {
                "kind": dice.choice([None, *kinds]),
                "class_name": dice.choice([None, "car", "bus"]),
                "wrong": dice.choice([None, *Wrong]),
                "beyond_m": dice.choice([None, 0, 4, 62]),
                "within_m": dice.choice([None, 63, 64, 81, 125]),
            }
            request = ScenesRequest(**asked)
            strong = [[t for t in each.tracks if t.strength >= 0.05] for each in scenes]
            is_filter = any(value is not None for value in asked.values())
            assert found(world, **asked, most=200) == [
                number
                for number, tracks in enumerate(strong)
                if not is_filter or any(passes(TrackSummary.of(t), request) for t in tracks)
            ], asked

    def test_pages_of_a_filter_by_range_follow_each_other(self, world: World) -> None:
        commit(world, *(scene(n, n / 50, tracks=(track_at(float(n)),)) for n in range(50)))
        for order in ("score", "newest", "earliest"):
            whole = ask(world, sort=order, within_m=37, beyond_m=6, most=200)
            assert sorted(numbers(whole.rows)) == list(range(7, 38))
            seen: list[str] = []
            after = ""
            while True:
                part = ask(world, sort=order, within_m=37, beyond_m=6, most=4, after=after)
                assert part.total == whole.total == 31
                seen += [row.scene_id for row in part.rows]
                if not part.next:
                    break
                after = part.next
            assert seen == [row.scene_id for row in whole.rows]


class TestTrackFiltersOnSqlite(OnSqlite, TrackFiltersContract):
    pass


@pytest.mark.integration
class TestTrackFiltersOnPostgres(OnPostgres, TrackFiltersContract):
    pass
