"""Failure modes: groups of like tracks, ids that stay as the fleet grows, and their rows."""

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.contradiction import ContradictionKind
from schemas.events import TrackSummary
from service.curation.candidates import Candidate
from service.curation.mode_rows import DAY_NS, modes_reply
from service.curation.modes import FIRST_GROUPED, ModeTrack, modes_of, tracks_of
from service.curation.ranking import RankedScene
from tests.factories import track_record

LIKE = (
    (ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, "car", 4.0, 15.0),
    (ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, "pedestrian", 0.6, 8.0),
    (ContradictionKind.ONLY_SEMANTIC_DYNAMIC, "", 1.0, 50.0),
)
"""Kind, class, length and distance of three ways to fail."""


def fleet(count: int, *, wrong: Wrong = Wrong.SUPERVISED) -> list[ModeTrack]:
    rng = np.random.default_rng(3)
    found = []
    for number in range(count):
        kind, class_name, length_m, range_m = LIKE[number % len(LIKE)]
        record = track_record(
            kind=kind,
            class_name=class_name,
            attribution=Attribution(
                wrong=wrong, supervised=0.9, selfsupervised=0.1, both=0.0, neither=0.0
            ),
        )
        size_m = (length_m * float(np.exp(0.1 * rng.standard_normal())), 1.0, 1.5)
        update = {"size_m": size_m, "range_m": range_m + float(rng.standard_normal())}
        strongest = record.strongest.model_copy(update=update)
        track = TrackSummary.of(record.model_copy(update={"strongest": strongest}))
        scene = RankedScene(
            rank=number + 1,
            scene_id=f"car-{number % 2}/lidar/{number}",
            log_id="a",
            start_ns=number * DAY_NS // 100,
            end_ns=number * DAY_NS // 100 + 2 * NS_PER_S,
            score=0.5,
            tracks=(track,),
            sha256="0" * 64,
        )
        found.append(Candidate(scene, f"car-{number % 2}", "2026.1", seq=number))
    return tracks_of(found)


def test_ways_to_fail_become_modes_with_names() -> None:
    modes = modes_of(fleet(300))
    assert [mode.name.split(",")[0] for mode in modes] != []
    assert {mode.name.split(",")[0] for mode in modes} == {"car", "pedestrian", "any class"}
    for mode in modes:
        assert len({each.track.class_name for each in mode.members}) == 1
    assert sum(len(mode.members) for mode in modes) >= 270


def test_a_mode_has_one_class_even_where_sizes_and_places_are_alike() -> None:
    tracks = fleet(384)[::3]
    vans = [
        ModeTrack(each.candidate, each.track.model_copy(update={"class_name": "van"}))
        if number % 2
        else each
        for number, each in enumerate(tracks)
    ]
    modes = modes_of(vans)
    assert sorted(mode.name.split(",")[0] for mode in modes) == ["car", "van"]
    assert [len(mode.members) for mode in modes] == [64, 64]


def test_members_keep_their_mode_as_the_fleet_grows() -> None:
    tracks = fleet(700)
    later = {each.key: mode.mode_id for mode in modes_of(tracks) for each in mode.members}
    for count in (FIRST_GROUPED, 200, 350):
        before = {
            each.key: mode.mode_id for mode in modes_of(tracks[:count]) for each in mode.members
        }
        assert before
        assert all(later[key] == mode_id for key, mode_id in before.items())


def test_a_new_way_to_fail_is_a_new_mode() -> None:
    new = fleet(60)[1::3]
    moved = [
        ModeTrack(each.candidate, each.track.model_copy(update={"class_name": "bus"}))
        for each in new
    ]
    usual = fleet(240)
    before, after = modes_of(usual[:128]), modes_of([*usual[:236], *moved])
    assert {mode.mode_id for mode in before} < {mode.mode_id for mode in after}
    assert "bus" in {mode.name.split(",")[0] for mode in after}


def test_there_is_no_mode_of_few_tracks_or_of_tracks_that_are_no_reason() -> None:
    assert modes_of(fleet(FIRST_GROUPED - 1)) == []
    assert fleet(200, wrong=Wrong.SELFSUPERVISED) == []


def test_rates_are_per_hour_driven_in_both_halves() -> None:
    tracks = fleet(300)
    driven_ns = {0: 3600 * NS_PER_S, 1: 3600 * NS_PER_S, 2: 2 * 3600 * NS_PER_S}
    reply = modes_reply(modes_of(tracks), tracks=len(tracks), driven_ns=driven_ns)
    assert reply.hours == 4.0
    assert reply.without == 300 - sum(row.tracks for row in reply.modes)
    row = reply.modes[0]
    assert row.per_hour == pytest.approx(row.tracks / 4, abs=1e-3)
    assert row.earlier_per_hour * 2 + (row.later_per_hour or 0) * 2 == pytest.approx(
        row.tracks, abs=1e-2
    )
    assert {each.name for each in row.vehicles} == {"car-0", "car-1"}
    assert len({each.scene_id for each in row.examples}) == 3
    one_day = modes_reply(modes_of(tracks), tracks=len(tracks), driven_ns={0: 1})
    assert one_day.modes[0].later_per_hour is None
