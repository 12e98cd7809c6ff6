"""Choices for selections on any database: earlier selections, filters, repeated requests, modes."""

import pytest

from schemas.arrays import NS_PER_S
from schemas.score import SceneScore
from schemas.surroundings import CloudStatistics, ScenePlace
from service.curation.listing import ScenesRequest
from service.curation.selection import SelectionTerms
from service.errors import NothingFoundError, UsageError
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import START_NS, World
from tests.contracts.store_contract import StoreContract
from tests.contracts.test_listing_contract import commit, scene
from tests.factories import track_at, track_record

NEAR_THE_MIDDLE = ScenesRequest(beyond_m=20, within_m=50)
STRATEGIES = ("best-distinct", "determinantal", "k-centre", "one-pass")


def mined(world: World, count: int = 12) -> None:
    """Commit scenes of falling scores that are no twins of each other, of two vehicles."""
    commit(
        world,
        *(
            scene(
                4 * number,
                0.9 - 0.05 * number,
                log_id="ab"[number % 2],
                vehicle=f"car-{number % 2}",
                tracks=(track_record(strength=0.5, class_name=("car", "bus")[number // 6]),),
            )
            for number in range(count)
        ),
    )


def two_days_in_a_street() -> list[SceneScore]:
    """A false alarm that stands, passed by two cars on two days, and elsewhere by a third."""
    street = ScenePlace(
        latitude_deg=48.137,
        longitude_deg=11.575,
        odom_m=(0.0, 0.0),
        odom_yaw_rad=0.2,
        heading_rad=0.2,
    )
    places = [street, street, street.model_copy(update={"latitude_deg": 48.2})]
    there = (15.0, 4.0, 0.0)
    alarm = track_record(
        strength=0.5, speed_m_per_s=0.0, first_odom_m=there, last_odom_m=there, class_name="car"
    )
    return [
        scene(500 * day, 0.8 - 0.1 * day, log_id="abc"[day], place=place, tracks=(alarm,))
        for day, place in enumerate(places)
    ]


def save(world: World, name: str | None, terms: SelectionTerms, budget: int = 4) -> list[str]:
    chosen = world.ledger.proposals.select(budget=budget, name=name, terms=terms)
    world.ledger.selections.save(name, budget=budget, scenes=chosen, strategy=terms.strategy)
    return [each.scene_id for each in chosen]


class ProposalsContract(StoreContract):
    @pytest.mark.parametrize("strategy", STRATEGIES)
    def test_a_scene_is_selected_once_unless_it_is_requested(
        self, world: World, strategy: str
    ) -> None:
        mined(world)
        terms = SelectionTerms(strategy=strategy)
        chosen = [save(world, f"week-{number}", terms) for number in range(3)]
        assert len({each for scenes in chosen for each in scenes}) == 12
        assert world.ledger.proposals.select(budget=4, terms=terms) == []
        assert world.ledger.proposals.propose(budget=4, terms=terms).taken == 12
        again = terms.model_copy(update={"again": True})
        assert [
            each.scene_id for each in world.ledger.proposals.select(budget=4, terms=again)
        ] == chosen[0]

    def test_the_same_request_for_a_name_gives_the_same_scenes(self, world: World) -> None:
        mined(world)
        terms = SelectionTerms(strategy="k-centre")
        first = save(world, "monday", terms)
        save(world, "tuesday", terms)
        assert save(world, "monday", terms) == first

    @pytest.mark.parametrize("strategy", STRATEGIES)
    def test_only_scenes_that_pass_the_filters_are_chosen(
        self, world: World, strategy: str
    ) -> None:
        mined(world)
        filters = ScenesRequest(vehicle="car-1", class_name="bus", sort="newest", most=1)
        terms = SelectionTerms(strategy=strategy, filters=filters)
        chosen = world.ledger.proposals.select(budget=9, terms=terms)
        assert {each.log_id for each in chosen} == {"b"}
        assert {each.tracks[0].class_name for each in chosen} == {"bus"}
        assert [each.rank for each in chosen] == [8, 10, 12], "ranks are those of all scenes"
        until = ScenesRequest(until_ns=START_NS + 9 * NS_PER_S)
        early = SelectionTerms(strategy=strategy, filters=until)
        assert len(world.ledger.proposals.select(budget=9, terms=early)) == 2

    def test_a_selection_is_of_scenes_with_a_track_within_a_range(self, world: World) -> None:
        ranges_m = (10.0, 45.0, 30.0, 70.0)
        tracks = [(track_at(range_m),) for range_m in ranges_m]
        commit(world, *(scene(4 * n, 0.9 - n / 10, tracks=tracks[n]) for n in range(4)))
        for within, ranks in ((ScenesRequest(within_m=30), [1, 3]), (NEAR_THE_MIDDLE, [2, 3])):
            chosen = world.ledger.proposals.select(budget=9, terms=SelectionTerms(filters=within))
            assert [each.rank for each in chosen] == ranks

    def test_what_cannot_be_chosen_by_is_refused(self, world: World) -> None:
        mined(world, 2)
        with pytest.raises(UsageError, match="no selection strategy 'nearest'; known: best-dist"):
            world.ledger.proposals.propose(budget=1, terms=SelectionTerms(strategy="nearest"))
        unknown = SelectionTerms(filters=ScenesRequest(selection="friday"))
        with pytest.raises(NothingFoundError, match="no selection 'friday'"):
            world.ledger.proposals.propose(budget=1, terms=unknown)

    def test_balance_knows_the_vehicles(self, world: World) -> None:
        mined(world)
        proposal = world.ledger.proposals.propose(
            budget=4, terms=SelectionTerms(strategy="determinantal")
        )
        assert "first of vehicle car-0" in proposal.choices[0].why
        assert any("first of vehicle car-1" in each.why for each in proposal.choices)

    def test_weather_in_the_records_takes_part_in_the_likeness(self, world: World) -> None:
        dry = CloudStatistics(returns=90_000, range_m=12.0, airborne_share=0.0)
        rain = dry.model_copy(update={"airborne_share": 0.004})
        weather = [dry, dry, dry, rain]
        scenes = [
            scene(4 * at, 0.9 - 0.01 * at, cloud=each, tracks=(track_record(strength=0.5),))
            for at, each in enumerate(weather)
        ]
        commit(world, *scenes)
        terms = SelectionTerms(strategy="k-centre")
        chosen = world.ledger.proposals.select(budget=2, terms=terms)
        assert [each.rank for each in chosen] == [1, 4]
        world.ledger.selections.save("first", budget=1, scenes=chosen[:1])
        assert world.ledger.proposals.select(budget=1, terms=terms)[0].rank == 4

    def test_what_stands_at_a_place_on_another_day_is_selected_last(self, world: World) -> None:
        commit(world, *two_days_in_a_street())
        ranking = world.ledger.ranking()
        assert [each.log_id for each in ranking] == ["a", "b", "c"]
        assert [each.twin_of for each in ranking] == [None, ranking[0].scene_id, None]
        assert ranking[0].place is not None
        assert ranking[0].place.latitude_deg == 48.137
        chosen = world.ledger.proposals.select(budget=2)
        assert [each.log_id for each in chosen] == ["a", "c"]
        assert [each.place for each in chosen] == [None, None], "selections are published"
        terms = SelectionTerms(strategy="k-centre")
        proposal = world.ledger.proposals.propose(budget=3, terms=terms)
        assert "first of place 48.1369 11.5746" in proposal.choices[0].why
        assert f"same place as {ranking[0].scene_id}, which fills" in proposal.choices[2].why

    def test_few_tracks_form_no_mode(self, world: World) -> None:
        mined(world)
        few = world.ledger.proposals.modes()
        assert (few.modes, few.tracks, few.without) == ((), 12, 12)

    def test_modes_count_what_current_scenes_show(self, world: World) -> None:
        commit(world, *(scene(number, 0.6) for number in range(150)))
        found = world.ledger.proposals.modes()
        assert found.tracks == 150
        assert sum(mode.tracks for mode in found.modes) + found.without == 150
        assert found.modes[0].kind == "only_predictive_dynamic"
        driven_ns = sum(row.end_ns - row.start_ns for row in world.ledger.ranking())
        assert found.hours == pytest.approx(driven_ns / NS_PER_S / 3600, abs=1e-4)


class TestProposalsOnSqlite(OnSqlite, ProposalsContract):
    pass


@pytest.mark.integration
class TestProposalsOnPostgres(OnPostgres, ProposalsContract):
    pass
