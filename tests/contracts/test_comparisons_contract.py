"""Sides of a comparison on any database: versions, filters, and what is no longer current."""

from typing import Any

import pytest

from schemas.contradiction import SceneState
from schemas.surroundings import ScenePlace
from service.curation.comparison import ComparedSide, CompareRequest, ComparisonTerms
from service.errors import NothingFoundError
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import START_NS, World
from tests.contracts.store_contract import StoreContract
from tests.contracts.test_listing_contract import commit, scene
from tests.factories import track_record

LOGS = tuple("abcdefgh")


def two_versions(world: World, **changes: Any) -> None:
    """Commit three scenes of each log; the second version misses a pedestrian in each."""
    commit(
        world,
        *(
            scene(
                number,
                log_id=log_id,
                vehicle=f"car-{at % 2}",
                software_version="2.5" if at >= 4 else "2.4",
                tracks=tuple(
                    track_record(track_id=one, strength=0.5, class_name=name)
                    for one, name in enumerate(("car", "pedestrian")[: 2 if at >= 4 else 1])
                ),
                **changes,
            )
            for at, log_id in enumerate(LOGS)
            for number in range(3)
        ),
    )


class ComparisonsContract(StoreContract):
    def test_two_software_versions_are_compared_by_class(self, world: World) -> None:
        two_versions(world)
        found = world.ledger.comparisons.compare(
            CompareRequest(
                a=ComparedSide(software_version="2.4"), b=ComparedSide(software_version="2.5")
            )
        )
        assert (found.a.logs, found.a.scenes, found.b.logs) == (4, 12, 4)
        assert (found.a.name, found.matched) == ("software 2.4", "roads")
        rows = {row.group: row for row in found.groups if row.by == "class"}
        assert (rows["pedestrian"].a.tracks, rows["pedestrian"].b.tracks) == (0, 12)
        assert (rows["car"].difference, rows["car"].outcome) == (0.0, "same")

    def test_a_place_in_the_records_of_both_sides_is_a_road_by_itself(self, world: World) -> None:
        street = ScenePlace(latitude_deg=48.137, longitude_deg=11.575, odom_m=(0.0, 0.0))
        two_versions(world, place=street)
        found = world.ledger.comparisons.compare(
            CompareRequest(
                a=ComparedSide(software_version="2.4"), b=ComparedSide(software_version="2.5")
            )
        )
        assert (found.roads, found.places, found.a.left_out) == (1, 1, 0)

    def test_a_side_has_filters(self, world: World) -> None:
        two_versions(world)
        side = world.ledger.comparisons.side(ComparedSide(vehicle="car-1"))
        assert {each.log_id for each in side.scenes} == set("bdfh")
        later = world.ledger.comparisons.side(ComparedSide(since_ns=START_NS + 1))
        assert len(later.scenes) == 16
        assert {each.start_ns for each in later.scenes}.isdisjoint({START_NS})

    def test_scenes_that_are_not_scored_are_not_compared(self, world: World) -> None:
        commit(world, scene(0), scene(1, 0.0, state=SceneState.TOO_SHORT, tracks=()))
        assert len(world.ledger.comparisons.side(ComparedSide()).scenes) == 1

    def test_an_earlier_pipeline_version_is_compared_with_the_one_that_replaced_it(
        self, world: World
    ) -> None:
        world.listed(*LOGS)
        world.mine_all("p1-old")
        world.plan_all("p2-new")
        world.mine_all("p2-new")
        assert {each.pipeline_version for each in world.ledger.current_scenes()} == {"p2-new"}
        found = world.ledger.comparisons.compare(
            CompareRequest(
                a=ComparedSide(pipeline_version="p1"),
                b=ComparedSide(pipeline_version="p2-new"),
                terms=ComparisonTerms(match="auto"),
            )
        )
        assert found.matched == "logs"
        assert found.a.scenes == found.b.scenes == 9 * len(LOGS)
        world.listed(*LOGS[1:])
        side = world.ledger.comparisons.side(ComparedSide(pipeline_version="p1-old"))
        assert LOGS[0] not in {each.log_id for each in side.scenes}, "its recording is gone"

    def test_an_unknown_version_is_said_with_those_that_there_are(self, world: World) -> None:
        two_versions(world)
        with pytest.raises(NothingFoundError, match=r"version '3' passes; known: 2\.4, 2\.5"):
            world.ledger.comparisons.side(ComparedSide(software_version="3"))
        with pytest.raises(NothingFoundError, match="no pipeline version 'x'; newest first: p1"):
            world.ledger.comparisons.side(ComparedSide(pipeline_version="x"))


class TestComparisonsOnSqlite(OnSqlite, ComparisonsContract):
    pass


@pytest.mark.integration
class TestComparisonsOnPostgres(OnPostgres, ComparisonsContract):
    pass
