"""Release gate: rates by log, matched roads, the same logs, Holm, outcomes and reports."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.contradiction import ContradictionKind, TrackRecord
from schemas.surroundings import ScenePlace
from service.cli.compare import side_of
from service.curation.compared_scenes import ComparedScene, NamedSide, match_scenes
from service.curation.comparing import compare
from service.curation.comparison import Comparison, ComparisonTerms
from service.curation.comparison_report import gate_sentence, markdown, place_lines
from service.curation.comparison_statistics import Road, holm, over_logs, over_roads
from service.errors import NothingFoundError, UsageError
from tests.factories import track_record

SCENES = 4
"""Scenes of a log."""


def version(
    logs: Sequence[int],
    rates: dict[str, float],
    *,
    name: str,
    seed: int,
    folder: str = "",
    speed_m_per_s: float = 6.0,
) -> NamedSide:
    """Draw scenes of logs, with Poisson numbers of tracks of each class, more on some logs."""
    rng = np.random.default_rng(seed)
    scenes = []
    for log in logs:
        often = rng.gamma(2.0, 0.5)
        for number in range(SCENES):
            start_ns = (log * 100 + 2 * number) * NS_PER_S
            tracks = [
                _track(class_name, start_ns, place_m=float(rng.uniform(5, 60)))
                for class_name, rate in rates.items()
                for _ in range(rng.poisson(rate * often))
            ]
            scenes.append(
                ComparedScene(
                    scene_id=f"{folder}{log}/lidar/{start_ns}",
                    log_id=f"{folder}{log}",
                    start_ns=start_ns,
                    end_ns=start_ns + 2 * NS_PER_S,
                    vehicle="car-1",
                    software_version=name,
                    seq=0,
                    score=0.5,
                    speed_m_per_s=speed_m_per_s,
                    moving_share=float(rng.uniform(0, 0.1)),
                    tracks=tuple(tracks),
                )
            )
    return NamedSide(name, scenes)


def _track(class_name: str, start_ns: int, *, place_m: float) -> TrackRecord:
    record = track_record(
        kind=ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, class_name=class_name, strength=0.5
    )
    strongest = record.strongest.model_copy(
        update={"stamp_ns": start_ns, "centre_m": (place_m, 0.0, 0.0), "range_m": place_m}
    )
    return record.model_copy(
        update={"first_ns": start_ns, "last_ns": start_ns + NS_PER_S, "strongest": strongest}
    )


USUAL = {"car": 0.5, "pedestrian": 0.3, "truck": 0.2}
WORSE = USUAL | {"pedestrian": 1.5}


def test_a_class_that_regressed_is_found_and_no_other() -> None:
    found = compare(
        version(range(30), USUAL, name="1", seed=1, folder="a"),
        version(range(30, 60), WORSE, name="2", seed=2, folder="b"),
        ComparisonTerms(),
    )
    assert found.matched == "roads"
    row = next(row for row in found.groups if row.group == "pedestrian")
    assert row.outcome == "regressed"
    assert row.low > 0
    assert row.corrected_low < row.low
    assert row.examples[0].side == "b"
    outcomes = {row.group: row.outcome for row in found.groups if row.by == "class"}
    assert outcomes == {"pedestrian": "regressed", "car": "same", "truck": "same"}
    assert found.groups[0].outcome == "regressed", "the worst is first"


def silent(side: NamedSide, share: float) -> NamedSide:
    """Let the model label that share of the returns, and contradict as much less."""
    scenes = [
        replace(
            scene, labelled_share=share, tracks=scene.tracks[: round(share * len(scene.tracks))]
        )
        for scene in side.scenes
    ]
    return NamedSide(side.name, scenes)


@pytest.mark.parametrize("folder", ["a", "b"], ids=["the same logs", "the same roads"])
def test_a_version_that_falls_silent_does_not_pass(folder: str) -> None:
    before = version(range(12), USUAL, name="1", seed=1, folder="a")
    after = version(range(12), USUAL, name="2", seed=1 if folder == "a" else 2, folder=folder)
    quiet = silent(after, 0.5)
    found = compare(before, quiet, ComparisonTerms())
    assert found.matched == ("logs" if folder == "a" else "roads")
    assert found.regressed == 0
    assert found.answers_less
    assert not found.passed
    assert "B answers less: it labels 50 % of the returns, A 100 %" in gate_sentence(found)
    assert "# Regression" in markdown(found)
    assert "| 50.0 % |" in markdown(found)
    assert compare(quiet, quiet, ComparisonTerms()).passed, "as much as before"
    louder = compare(quiet, after, ComparisonTerms())
    assert not louder.answers_less
    assert "B labels 100 % of the returns, A only 50 %" in gate_sentence(louder)
    assert not compare(before, silent(after, 0.96), ComparisonTerms()).answers_less


def test_a_share_that_differs_from_log_to_log_is_no_silence() -> None:
    rng = np.random.default_rng(3)
    before, after = (
        NamedSide(
            side.name,
            [replace(scene, labelled_share=float(rng.uniform(0.5, 1.0))) for scene in side.scenes],
        )
        for side in (
            version(range(8), USUAL, name="1", seed=1, folder="a"),
            version(range(8, 16), USUAL, name="2", seed=2, folder="b"),
        )
    )
    assert not compare(before, after, ComparisonTerms()).answers_less


def test_the_way_back_is_an_improvement() -> None:
    found = compare(
        version(range(30), WORSE, name="1", seed=1, folder="a"),
        version(range(30, 60), USUAL, name="2", seed=2, folder="b"),
        ComparisonTerms(),
    )
    assert found.regressed == 0
    assert found.improved >= 1
    assert "improved" in gate_sentence(found)


def test_equal_versions_raise_few_alarms() -> None:
    alarms = 0
    for seed in range(20):
        alarms += (
            compare(
                version(range(20), USUAL, name="1", seed=2 * seed, folder="a"),
                version(range(20, 40), USUAL, name="2", seed=2 * seed + 1, folder="b"),
                ComparisonTerms(),
            ).regressed
            > 0
        )
    assert alarms <= 1


def test_the_same_logs_show_what_is_gone_and_what_is_new() -> None:
    before = version(range(12), USUAL, name="1", seed=1)
    worse = [
        ComparedScene(
            **{name: getattr(scene, name) for name in ComparedScene.__slots__}
            | {"tracks": (*scene.tracks, _track("bus", scene.start_ns, place_m=90.0))}
        )
        for scene in before.scenes
    ]
    found = compare(before, NamedSide("2", worse), ComparisonTerms())
    assert (found.matched, found.roads) == ("logs", 0)
    bus = next(row for row in found.groups if row.group == "bus")
    assert (bus.outcome, bus.gone, bus.new) == ("regressed", 0, 12 * SCENES)
    car = next(row for row in found.groups if row.group == "car")
    assert (car.outcome, car.gone, car.new, car.p) == ("same", 0, 0, 1.0)
    assert compare(before, before, ComparisonTerms()).regressed == 0


def test_a_tolerated_rise_is_no_regression() -> None:
    sides = (
        version(range(40), {"car": 1.0}, name="1", seed=1, folder="a"),
        version(range(40), {"car": 2.0}, name="2", seed=2, folder="b"),
    )
    assert compare(*sides, ComparisonTerms()).regressed > 0
    assert compare(*sides, ComparisonTerms(tolerance=2.0)).regressed == 0


def test_scenes_of_a_road_that_one_side_lacks_are_left_out() -> None:
    slow = version(range(10), USUAL, name="1", seed=1, folder="a", speed_m_per_s=1.0)
    fast = version(range(10), USUAL, name="1", seed=2, folder="c", speed_m_per_s=20.0)
    other = version(range(10), USUAL, name="2", seed=3, folder="b", speed_m_per_s=20.0)
    both = NamedSide("1", [*slow.scenes, *fast.scenes])
    matched = match_scenes(both, other, "roads")
    assert {scene.speed_m_per_s for scene in matched.a} == {20.0}
    assert compare(both, other, ComparisonTerms(match="roads")).a.left_out == 40
    with pytest.raises(NothingFoundError, match="no kind of road in common"):
        compare(slow, other, ComparisonTerms(match="roads"))
    with pytest.raises(NothingFoundError, match=r"no log in common: .* --match roads"):
        compare(slow, other, ComparisonTerms(match="logs"))


def at(latitude_deg: float, side: NamedSide) -> list[ComparedScene]:
    place = ScenePlace(latitude_deg=latitude_deg, longitude_deg=11.0, odom_m=(0.0, 0.0))
    return [replace(scene, place=place) for scene in side.scenes]


def test_scenes_of_a_place_that_both_passed_are_compared_with_each_other() -> None:
    busy, calm = {"car": 4.0}, {"car": 0.3}
    sides = []
    for name, seed, shares in (("1", 1, (30, 5)), ("2", 5, (5, 30))):
        crossing = version(range(shares[0]), busy, name=name, seed=seed, folder=f"{name}-x")
        lane = version(range(shares[1]), calm, name=name, seed=seed + 1, folder=f"{name}-y")
        sides.append(NamedSide(name, [*at(48.0, crossing), *at(48.1, lane)]))
    one, other = sides
    matched = match_scenes(one, other, "roads")
    assert (matched.roads, list(matched.places)) == (2, ["47.9995 10.9992", "48.0992 10.9995"])
    assert np.bincount(matched.road_a).tolist() == [30 * SCENES, 5 * SCENES]
    found = compare(one, other, ComparisonTerms(match="roads"))
    assert (found.regressed, found.improved) == (0, 0), "both are as good at the same places"
    assert "over 2 places, corrected" in gate_sentence(found)
    rose, fell = found.at_places
    assert (fell.place, rose.place) == tuple(matched.places)
    assert [(row.a.logs, row.b.logs) for row in found.at_places] == [(5, 30), (30, 5)]
    assert fell.a.tracks == sum(len(s.tracks) for s in one.scenes if s.log_id[2] == "x")
    first, more = place_lines(found, most=1)
    assert first.startswith("place 48.0992 10.9995: logs 5 of A and 30 of B, scenes 20 and 120, ")
    assert more == "and 1 more place"
    assert "* place 47.9995 10.9992: " in markdown(found)
    assert "corrected by Holm" in markdown(found).splitlines()[2]
    bare_one, bare_other = (
        NamedSide(each.name, [replace(s, place=None) for s in each.scenes]) for each in sides
    )
    unmatched = compare(bare_one, bare_other, ComparisonTerms(match="roads"))
    assert unmatched.improved > 0, "B drove in calmer streets"
    assert not {"places", "places_too_few", "at_places"} & unmatched.model_dump().keys()


def test_a_place_that_few_logs_of_a_side_passed_goes_by_its_kind_of_road() -> None:
    a = NamedSide("1", at(48.0, version(range(10), USUAL, name="1", seed=1, folder="a")))
    few = at(48.0, version(range(3), USUAL, name="2", seed=2, folder="b"))
    others = version(range(10), USUAL, name="2", seed=3, folder="c").scenes
    matched = match_scenes(a, NamedSide("2", [*few, *others]), "roads")
    assert (list(matched.places), len(matched.a)) == ([], 10 * SCENES)
    found = compare(a, NamedSide("2", [*few, *others]), ComparisonTerms(match="roads"))
    (line,) = place_lines(found, most=5)
    assert line.startswith("1 place that both sides passed, one of them on fewer than 4 logs")
    many = at(48.0, version(range(5), USUAL, name="2", seed=2, folder="b"))
    mixed = match_scenes(a, NamedSide("2", [*many, *others]), "roads")
    assert (mixed.roads, len(mixed.places), len(mixed.b)) == (1, 1, 5 * SCENES)


def test_too_little_to_compare_is_one_sentence() -> None:
    some = version(range(10), USUAL, name="1", seed=1)
    with pytest.raises(NothingFoundError, match="no scored scene of 2: there is nothing"):
        compare(some, NamedSide("2", []), ComparisonTerms())
    with pytest.raises(UsageError, match="1 has 2 logs that both sides have"):
        compare(some, version(range(2), USUAL, name="3", seed=1), ComparisonTerms())


def test_holm_corrects_the_smallest_for_all() -> None:
    corrected, levels = holm(np.array([0.04, 0.001, 0.03]))
    assert corrected.tolist() == pytest.approx([0.06, 0.003, 0.06])
    assert levels.tolist() == pytest.approx([0.05, 0.05 / 3, 0.025])


def test_an_exchange_of_logs_is_exact_for_few() -> None:
    counts = np.array([[0.0], [0.0], [0.0], [0.0], [1.0], [1.0], [1.0], [1.0]])
    is_b = np.arange(8) >= 4
    tested = over_roads([Road(np.ones(8), counts)], is_b, tolerance=0.0)
    assert tested.p[0] == pytest.approx(2 / 70, abs=0.005)
    assert (tested.rate_a[0], tested.rate_b[0]) == (0.0, 1.0)
    paired = over_logs(np.ones(8), counts * 0, np.ones((8, 1)), tolerance=0.0)
    assert paired.p[0] == pytest.approx(2 / 256, abs=0.003)


def test_many_logs_are_tested_by_the_normal_limit() -> None:
    rng = np.random.default_rng(1)
    is_b = np.arange(3000) % 2 == 0
    same = rng.poisson(1.0, (3000, 1)).astype(np.float64)
    more = same + is_b[:, None] * rng.poisson(0.3, (3000, 1))
    road = np.ones(3000)
    assert over_roads([Road(road, same)], is_b, tolerance=0.0).p[0] > 0.01
    assert over_roads([Road(road, more)], is_b, tolerance=0.0).p[0] < 1e-6
    assert over_roads([Road(road, more)], is_b, tolerance=0.3).p[0] > 0.01


def test_a_report_names_groups_and_scenes() -> None:
    found = compare(
        version(range(30), USUAL, name="1|x", seed=1, folder="a"),
        version(range(30, 60), WORSE, name="2", seed=2, folder="b"),
        ComparisonTerms(),
    )
    text = markdown(found)
    assert text.startswith("# Regression: B against A\n")
    assert "| class pedestrian |" in text
    assert "1\\|x" in text
    assert found.groups[0].examples[0].scene_id in text
    assert Comparison.model_validate_json(found.model_dump_json()) == found


@pytest.mark.parametrize(
    ("said", "problem"),
    [
        ("2026.1", "'2026.1' is no term of a version"),
        ("software=1,software=2", "each once"),
        ("software=", "is no term"),
        ("since=yesterday", "since is no time"),
        ("colour=red", "of software, pipeline, state"),
    ],
)
def test_a_side_that_says_nothing_known_is_refused(said: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        side_of(said, "--a", now_s=0.0)


def test_a_side_has_terms_and_a_state() -> None:
    folder, side = side_of("state=old, software=2026.1,since=2026-03-02", "--a", now_s=0.0)
    assert str(folder) == "old"
    assert side.software_version == "2026.1"
    assert side.since_ns > 0
