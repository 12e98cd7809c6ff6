from datetime import UTC, datetime
from pathlib import Path

import pytest

from schemas.arrays import NS_PER_S
from service.cli import rates as verb
from service.curation.rates import (
    OutcomePoints,
    RateRow,
    RatesRequest,
    RateSums,
    rates,
    rates_request,
)
from service.errors import UsageError
from service.pictures.outcomes import draw_outcomes

NOW_S = datetime(2026, 11, 21, 12, tzinfo=UTC).timestamp()


def ns(text: str) -> int:
    return round(datetime.fromisoformat(text).timestamp()) * NS_PER_S


def sums(group: str | int, **changed: int | float) -> RateSums:
    nothing: dict[str, int | float] = dict.fromkeys(
        (
            "scenes",
            "frames",
            "compared",
            "both_dynamic",
            "only_semantic",
            "only_predictive",
            "contradicting_scenes",
            "semantic_scenes",
            "predictive_scenes",
            "gated_scenes",
            "score_sum",
            "best_score",
        ),
        0,
    )
    return RateSums(group=group, **(nothing | changed))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("since", "since_ns"),
    [
        ("", 0),
        ("24h", ns("2026-11-20T12:00:00+00:00")),
        ("7d", ns("2026-11-14T12:00:00+00:00")),
        ("2w", ns("2026-11-07T12:00:00+00:00")),
        ("90m", ns("2026-11-21T10:30:00+00:00")),
        ("2026-11-20", ns("2026-11-20T00:00:00+00:00")),
        ("2026-11-20T08:00:00Z", ns("2026-11-20T08:00:00+00:00")),
        ("2026-11-20T08:00:00+02:00", ns("2026-11-20T06:00:00+00:00")),
        ("2026-11-20 08:00", ns("2026-11-20T08:00:00+00:00")),
        ("1763625600000", ns("2025-11-20T08:00:00+00:00")),
        ("999999w", 0),
    ],
)
def test_since_is_a_time_a_date_or_so_long_ago(since: str, since_ns: int) -> None:
    assert rates_request("hour", since=since, now_s=NOW_S).since_ns == since_ns


def test_a_fraction_of_a_second_is_kept() -> None:
    asked = rates_request("log", since="2026-11-20T08:00:00.250001Z", now_s=NOW_S)
    assert asked.since_ns == ns("2026-11-20T08:00:00+00:00") + 250_001_000


@pytest.mark.parametrize(
    ("by", "since", "until", "said"),
    [
        ("scene", "", "", "vehicle, version, kind, hour, log"),
        ("hour", "yesterday", "", "2026-11-20T08:00:00Z"),
        ("hour", "", "5 days", "24h"),
        ("hour", "2026-11-20", "2026-11-19", "later than since"),
        ("hour", "1h", "2h", "later than since"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(
    by: str, since: str, until: str, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        rates_request(by, since=since, until=until, now_s=NOW_S)


def test_a_group_without_a_compared_point_has_rate_zero() -> None:
    (row,) = rates([sums("car-1", scenes=2, gated_scenes=2)], "vehicle")
    assert (row.disagreement_rate, row.mean_score) == (0.0, 0.0)


def test_groups_that_disagree_alike_are_in_the_order_of_their_names() -> None:
    rows = rates([sums("b"), sums("c", compared=10, only_semantic=1), sums("a")], "log")
    assert [row.group for row in rows] == ["c", "a", "b"]


def test_the_bar_shows_both_kinds_in_proportion_to_the_worst_row() -> None:
    whole = sums("a", compared=1000, only_semantic=75, only_predictive=25)
    half = sums("b", compared=1000, only_semantic=0, only_predictive=50)
    rows = rates([whole, half, sums("c")], "log")
    bars = [verb._bar(row, worst=0.1) for row in rows]
    assert bars == ["█" * 15 + "▒" * 5, "▒" * 10, ""]


def test_a_row_travels_and_comes_back() -> None:
    (row,) = rates([sums(472_222, scenes=1, compared=3, only_semantic=1)], "hour")
    assert row.time == "2023-11-14T22:00:00Z"
    assert RateRow.model_validate_json(row.model_dump_json()) == row
    request = RatesRequest(by="hour", since_ns=5)
    assert RatesRequest.model_validate_json(request.model_dump_json()) == request


@pytest.mark.parametrize("late", ["2300-01-01", "9999999999999", "9999-12-31T23:59:59-23:00"])
@pytest.mark.parametrize("side", ["since", "until"])
def test_a_time_beyond_the_range_of_nanoseconds_is_refused_in_a_sentence(
    late: str, side: str
) -> None:
    with pytest.raises(UsageError, match=f"{side} is too late: '{late}'; times end in April 2262"):
        rates_request("hour", now_s=1e9, **{side: late})


def test_data_sets_are_the_first_folders_and_have_outcomes() -> None:
    logs = [
        sums("kitti/car/day/a", scenes=1, compared=100, both_dynamic=5, only_semantic=10),
        sums("kitti/car/day/b", scenes=2, compared=50, only_predictive=20, best_score=0.5),
        sums("pandaset/x/y/c", scenes=1, compared=10, both_dynamic=1, best_score=0.2),
    ]
    first, second = rates(logs, "dataset")
    assert (first.group, first.scenes, first.best_score) == ("kitti", 3, 0.5)
    assert first.disagreement_rate == pytest.approx(30 / 150)
    assert first.outcomes is not None
    assert first.outcomes.model_dump() == {
        **{"both_static": 115, "both_dynamic": 5},
        **{"only_predictive_dynamic": 20, "only_semantic_dynamic": 10},
    }
    assert second.group == "pandaset"
    assert rates(logs, "log")[0].outcomes is None


def test_the_picture_of_outcomes_has_a_bar_for_each_category() -> None:
    found = OutcomePoints(
        **{"both_static": 10_000, "both_dynamic": 800},
        **{"only_predictive_dynamic": 90, "only_semantic_dynamic": 0},
    )
    image = draw_outcomes({"kitti": found, "a very long name of a data set <b>": found})
    colours = {colour for _, colour in image.getcolors(maxcolors=1 << 20) or ()}
    assert {(34, 139, 34), (65, 105, 225), (178, 34, 34), (225, 225, 0)} <= colours
    assert draw_outcomes({}).size == (640, image.size[1])


def test_a_plot_needs_the_grouping_by_data_set(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="give --by dataset"):
        verb.rates(by="vehicle", plot=tmp_path / "a.png")
