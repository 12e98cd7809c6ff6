"""Strategies that cover: unlike scenes first, balance, earlier selections, one pass, bounds."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.events import TrackSummary
from schemas.surroundings import CloudStatistics, ScenePlace
from service.curation.candidates import PLACE, Candidate, Rows, rows_of
from service.curation.descriptors import WEATHER_WEIGHT, WIDTH, describe
from service.curation.greedy import ReadPool, pick, pick_from, value_of
from service.curation.objectives import BALANCE, DETERMINANTAL, K_CENTRE, ObjectiveKind
from service.curation.one_pass import OnePass
from service.curation.ranking import RankedScene
from service.curation.strategies.catalogue import select
from service.evaluation.synthetic_rows import SyntheticPool
from tests.factories import track_record

COVERING = ("determinantal", "k-centre", "one-pass")
BOTH = pytest.mark.parametrize("objective", [DETERMINANTAL, K_CENTRE], ids=["dpp", "k-centre"])


def scene(
    rank: int,
    score: float,
    class_name: str = "car",
    *,
    range_m: float = 12.0,
    vehicle: str = "car-7",
    twin_of: str | None = None,
) -> Candidate:
    record = track_record(strength=score, class_name=class_name)
    strongest = record.strongest.model_copy(update={"range_m": range_m})
    track = TrackSummary.of(record.model_copy(update={"strongest": strongest}))
    ranked = RankedScene(
        rank=rank,
        scene_id=f"a/lidar/{rank}",
        log_id="a",
        start_ns=rank * NS_PER_S,
        end_ns=(rank + 1) * NS_PER_S,
        score=score,
        tracks=(track,),
        twin_of=twin_of,
        sha256="0" * 64,
    )
    return Candidate(ranked, vehicle=vehicle)


def ranks(
    candidates: Sequence[Candidate],
    *,
    budget: int,
    strategy: str,
    taken: Sequence[Candidate] = (),
) -> list[int]:
    chosen = select(candidates, budget=budget, strategy=strategy, taken=taken)
    return [each.scene.rank for each in chosen]


SAME = [scene(rank, 0.9 - 0.01 * rank) for rank in range(1, 9)]
OTHERS = [scene(9, 0.6, "pedestrian", range_m=3.0), scene(10, 0.5, "truck", range_m=70.0)]


@pytest.mark.parametrize("strategy", COVERING)
def test_unlike_scenes_come_before_ones_that_show_the_same(strategy: str) -> None:
    assert set(ranks(SAME + OTHERS, budget=3, strategy=strategy)) == {1, 9, 10}
    assert ranks(SAME + OTHERS, budget=3, strategy="best-distinct") == [1, 2, 3]


@pytest.mark.parametrize("strategy", ["determinantal", "k-centre"])
def test_what_was_taken_before_counts_as_chosen(strategy: str) -> None:
    first = ranks(SAME + OTHERS, budget=1, strategy=strategy, taken=[scene(99, 0.95)])
    assert first == [9], "the best scene is like the one taken"


@BOTH
def test_of_equal_scenes_that_of_another_vehicle_is_next(objective: ObjectiveKind) -> None:
    equal = [scene(rank, 0.8, vehicle="car-7") for rank in range(1, 5)]
    rows = rows_of([*equal, scene(5, 0.8, vehicle="car-9")])
    numbers, _ = pick_from(rows, objective, budget=2)
    assert 4 in numbers.tolist()


@pytest.mark.parametrize("strategy", ["determinantal", "k-centre"])
def test_twins_fill_the_budget_and_come_last(strategy: str) -> None:
    twin = scene(2, 0.85, "bus", twin_of="a/lidar/1")
    assert ranks([scene(1, 0.9), twin, scene(3, 0.3)], budget=2, strategy=strategy) == [1, 3]
    assert ranks([scene(1, 0.9), twin, scene(3, 0.3)], budget=9, strategy=strategy) == [1, 3, 2]


def test_each_choice_is_explained() -> None:
    chosen = select(SAME + OTHERS, budget=10, strategy="k-centre")
    assert "score 0.890: only_predictive_dynamic car" in chosen[0].why
    assert "first of vehicle car-7" in chosen[0].why
    assert "unlike all; nearest is rank 1 (likeness" in chosen[1].why
    assert "; like rank" in chosen[-1].why
    assert all(one.gain >= other.gain for one, other in pairwise(chosen))


def test_descriptors_are_unit_vectors_and_likeness_is_a_share() -> None:
    found = describe([each.scene for each in SAME + OTHERS])
    assert found.shape == (10, WIDTH)
    assert np.allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-5)
    likeness = found @ found.T
    assert likeness.min() >= 0.0
    assert likeness[0, 1] == pytest.approx(1.0, abs=1e-3)
    assert likeness[0, 8] < 0.8


DRY = CloudStatistics(returns=100_000, range_m=12.0, airborne_share=0.0, intensity=0.1)
RAIN = DRY.model_copy(update={"airborne_share": 0.004})


def test_scenes_without_weather_are_as_alike_as_their_tracks() -> None:
    tracks = describe([each.scene for each in SAME + OTHERS])
    whole = rows_of(SAME + OTHERS).descriptors
    np.testing.assert_allclose(whole @ whole.T, tracks @ tracks.T, atol=1e-6)


def test_the_weather_is_a_small_part_of_the_likeness() -> None:
    dry, also_dry, rain = (replace(SAME[0], cloud=each) for each in (DRY, DRY, RAIN))
    found = rows_of([dry, also_dry, rain, SAME[0]]).descriptors
    likeness = found @ found.T
    np.testing.assert_allclose(np.diag(likeness), 1.0, atol=1e-5)
    assert likeness[0, 1] == pytest.approx(1.0, abs=1e-5)
    assert 1 - WEATHER_WEIGHT <= likeness[0, 2] < 1 - 0.4 * WEATHER_WEIGHT
    assert likeness[0, 3] == pytest.approx(np.sqrt(1 - WEATHER_WEIGHT), abs=1e-5)


@pytest.mark.parametrize("strategy", ["determinantal", "k-centre"])
def test_of_scenes_that_show_the_same_one_in_other_weather_comes_first(strategy: str) -> None:
    dry = [replace(each, cloud=DRY) for each in SAME[:5]]
    wet = replace(SAME[5], cloud=RAIN)
    assert ranks([*dry, wet], budget=2, strategy=strategy) == [1, 6]
    assert ranks(SAME[:6], budget=2, strategy=strategy) == [1, 2]


HERE = ScenePlace(latitude_deg=48.137, longitude_deg=11.575, odom_m=(0.0, 0.0))
THERE = HERE.model_copy(update={"latitude_deg": 48.3})


@pytest.mark.parametrize("strategy", ["determinantal", "k-centre"])
def test_of_equal_scenes_that_of_another_place_is_next(strategy: str) -> None:
    equal = [replace(scene(rank, 0.8), place=HERE) for rank in range(1, 5)]
    elsewhere = replace(scene(5, 0.8), place=THERE)
    assert ranks([*equal, elsewhere], budget=2, strategy=strategy) == [1, 5]
    why = [each.why for each in select([*equal, elsewhere], budget=3, strategy=strategy)]
    assert "first of place 48.2995 11.5750" in why[1]
    assert "within 100 m of rank 1" in why[2]


@BOTH
def test_an_unknown_place_is_no_place_that_scenes_share(objective: ObjectiveKind) -> None:
    rows = rows_of(SAME + OTHERS)
    placed = rows_of([replace(each, place=HERE) for each in SAME + OTHERS])
    more = BALANCE * np.log1p(rows.quality)
    np.testing.assert_allclose(
        objective.begin(placed).gains() - objective.begin(rows).gains(), more, atol=1e-9
    )
    assert (rows.groups[:, PLACE] == 0).all()
    assert (placed.groups[:, PLACE] != 0).all()


def test_a_twin_in_place_says_so() -> None:
    twin = scene(2, 0.8, twin_of="another-day/lidar/9")
    why = [each.why for each in select([scene(1, 0.9), twin], budget=2, strategy="k-centre")]
    assert why[1] == "score 0.800: same place as another-day/lidar/9, which fills the budget"


@BOTH
def test_no_candidate_adds_more_than_its_score_allows(objective: ObjectiveKind) -> None:
    rows = SyntheticPool(400, even=True).first(400)
    state = objective.begin(rows)
    for number in range(0, 400, 40):
        before = state.gains()
        most = np.array([objective.most(score) for score in rows.quality.tolist()])
        assert (before <= most + 1e-6).all()
        state.take(number)
        assert (state.gains() <= before + 1e-5).all(), "what a candidate adds never grows"


@BOTH
def test_reading_a_part_gives_the_choice_of_all(objective: ObjectiveKind) -> None:
    pool = SyntheticPool(6000, even=False)
    part = pick(pool, objective, budget=20)
    assert part.compared < 6000
    assert part.missed == 0.0
    everything, _ = pick_from(pool.first(6000), objective, budget=20)
    assert part.numbers.tolist() == everything.tolist()


@BOTH
def test_what_may_be_missed_is_bounded(objective: ObjectiveKind) -> None:
    pool = SyntheticPool(20_000, even=True)
    part = pick(pool, objective, budget=250, most_read=512)
    _, gains = pick_from(pool.first(20_000), objective, budget=250)
    assert part.compared == 512
    assert part.missed > 0
    assert gains[-1] - part.gains[-1] <= part.missed


def test_the_log_determinant_is_the_sum_of_the_gains() -> None:
    rows = SyntheticPool(200, even=True).first(200)
    one_group = Rows(rows.quality, rows.descriptors, np.zeros_like(rows.groups))
    numbers, gains = pick_from(one_group, DETERMINANTAL, budget=12)
    from service.curation.objectives import SHARPNESS, SPREAD

    quality, found = rows.quality[numbers], rows.descriptors[numbers].astype(np.float64)
    matrix = np.eye(12) + SPREAD * np.outer(quality, quality) * (found @ found.T) ** SHARPNESS
    balance = 3 * BALANCE * np.log1p(quality.sum())
    assert gains.sum() == pytest.approx(np.linalg.slogdet(matrix)[1] + balance, rel=1e-3)


@BOTH
@pytest.mark.parametrize("seed", [0, 1])
def test_one_pass_in_any_order_reaches_the_offline_choice(
    objective: ObjectiveKind, seed: int
) -> None:
    pool = SyntheticPool(10_000, even=False, seed=seed)
    rows = pool.first(10_000)
    best = value_of(rows, pick(pool, objective, budget=20).numbers.tolist(), objective)
    for order in (np.random.default_rng(seed).permutation(10_000), np.arange(10_000)[::-1]):
        stream = OnePass[int](objective, budget=20)
        for some in np.array_split(order, 7):
            stream.offer(some.tolist(), rows.at(some))
        chosen = [number for number, _ in stream.chosen()]
        assert value_of(rows, chosen, objective) >= 0.95 * best


def test_a_pool_reads_no_further_than_asked() -> None:
    read = []

    def reading() -> Iterator[Candidate]:
        for each in SAME:
            read.append(each.scene.rank)
            yield each

    pool = ReadPool(reading())
    assert len(pool.first(3)) == 3
    assert read == [1, 2, 3]
    assert pool.quality_at(3) == SAME[3].scene.score
    assert pool.quality_at(50) == 0.0
    assert len(pool.first(50)) == 8
