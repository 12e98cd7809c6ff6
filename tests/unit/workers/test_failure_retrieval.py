import numpy as np
import pytest

from workers.lab.evaluation.failures.calibration import calibrate
from workers.lab.evaluation.failures.intervals import bootstrap
from workers.lab.evaluation.failures.ranking import Items, random_row, row_of
from workers.lab.evaluation.failures.retrieval import (
    area_under,
    budget_size,
    found_curve,
    found_within,
    random_retrieval,
    retrieve,
)


def wanted(*places: int, of: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    mask = np.zeros(of, np.bool_)
    mask[list(places)] = True
    return mask


def test_a_perfect_ranking_has_an_average_precision_of_one() -> None:
    found = retrieve(np.arange(100.0)[::-1], wanted(0, 1, 2, 3, 4, of=100))
    assert found.ap == 1.0
    assert found.precision_at == {"0.5": 1.0, "1": 1.0, "2": 1.0, "5": 1.0, "10": 0.5}
    assert found.recall_at == {"0.5": 0.2, "1": 0.2, "2": 0.4, "5": 1.0, "10": 1.0}
    assert found.lift_at["5"] == 20.0


def test_average_precision_is_the_mean_of_precisions_where_something_is_found() -> None:
    found = retrieve(np.array([5.0, 4.0, 3.0, 2.0]), wanted(0, 2, of=4))
    assert found.ap == pytest.approx((1 / 1 + 2 / 3) / 2)


def test_equal_scores_count_as_in_random_order() -> None:
    scores = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    assert found_within(scores, wanted(1, 2, of=5), 3) == pytest.approx(2 * 2 / 4)
    assert found_within(scores, wanted(0, 1, of=5), 1) == 1.0


def test_a_random_order_is_expected_to_do_what_many_random_orders_do() -> None:
    mask = wanted(*range(6), of=40)
    rng = np.random.default_rng(0)
    many = [retrieve(rng.random(40), mask) for _ in range(1000)]
    expected = random_retrieval(mask)
    assert expected.ap == pytest.approx(np.mean([each.ap for each in many]), abs=0.01)
    assert expected.precision_at["10"] == pytest.approx(6 / 40)
    shares = [each.recall_at["10"] for each in many]
    assert expected.recall_at["10"] == pytest.approx(np.mean(np.array(shares, float)), abs=0.01)


def test_nothing_to_be_found_has_no_average_precision() -> None:
    found = retrieve(np.array([0.3, 0.1]), wanted(of=2))
    assert found.ap is None
    assert found.recall_at["5"] is None
    assert random_retrieval(wanted(of=2)).ap is None


def test_a_budget_pays_for_one_item_at_least() -> None:
    assert budget_size(0.005, 60) == 1
    assert budget_size(0.05, 600) == 30
    assert budget_size(0.1, 0) == 0


def test_a_failure_over_two_scenes_is_found_once() -> None:
    curve = found_curve(np.array([3.0, 2.0, 1.0]), [["a"], ["a"], ["b"]])
    np.testing.assert_allclose(curve, [0.0, 0.5, 0.5, 1.0])
    assert area_under(curve) == pytest.approx((0.25 + 0.5 + 0.75) / 3)


def test_failures_found_are_told_for_each_minute_looked_at() -> None:
    items = Items(
        logs=np.repeat([0, 1], 10),
        wanted=wanted(0, 1, of=20),
        failures=[["a"], ["b"], *([[]] * 18)],
        minutes=np.full(20, 0.5),
        scenes=20,
    )
    row = row_of(np.arange(20.0)[::-1], items, draws=0)
    assert row.found_per_minute_at["10"] == pytest.approx(2.0)  # both in two scenes, one minute
    assert row.ap_interval is None
    assert random_row(items).found_per_minute_at["10"] == pytest.approx(0.2)


def test_intervals_draw_whole_logs() -> None:
    groups = [0] * 5 + [1] * 5 + [2] * 5
    values = np.array([0.0] * 5 + [1.0] * 5 + [2.0] * 5)
    drawn: list[int] = []

    def mean(items: np.ndarray[tuple[int], np.dtype[np.int64]]) -> tuple[float | None, ...]:
        drawn.append(len(items))
        assert set(np.bincount(values[items].astype(int), minlength=3) % 5) == {0}
        return float(values[items].mean()), None

    interval, nothing = bootstrap(groups, mean, draws=300)
    assert nothing is None
    assert interval is not None
    assert interval[0] == 0.0
    assert interval[1] == 2.0
    assert set(drawn) == {15}


def test_of_too_few_logs_no_interval_is_said() -> None:
    values = np.arange(10.0)

    def mean(items: np.ndarray[tuple[int], np.dtype[np.int64]]) -> tuple[float | None, ...]:
        return (float(values[items].mean()), 1.0)

    assert bootstrap([0] * 10, mean, draws=50) == [None, None]
    assert bootstrap([0] * 5 + [1] * 5, mean, draws=50) == [None, None]
    assert None not in bootstrap([0] * 4 + [1] * 3 + [2] * 3, mean, draws=50)


def test_a_score_that_says_how_often_it_is_right_has_no_error() -> None:
    said = np.repeat([0.25, 0.75], 400)
    was = np.concatenate([np.arange(400) < 100, np.arange(400) < 300])
    found = calibrate(said, was)
    assert found.ece == 0.0
    assert [each.count for each in found.bins] == [400, 400]
    assert calibrate(np.full(10, 0.95), np.zeros(10, np.bool_)).ece == pytest.approx(0.95)
    assert calibrate([], np.zeros(0, np.bool_)).ece is None
