"""Ranges as bits: a filter by them is exact for whole metres."""

import random

import pytest

from schemas.transport.wire import encode
from service.curation.listing import ScenesRequest
from service.curation.ranges import MAX_BOUND_M, bits_between, bits_of


def passes(ranges_m: list[float], beyond_m: int | None, within_m: int | None) -> bool:
    near, far = bits_of(ranges_m)
    wanted = bits_between(beyond_m, within_m)
    assert max(near, far, *wanted) < 2**63
    return bool(near & wanted[0] or far & wanted[1])


@pytest.mark.parametrize("seed", range(20))
def test_a_filter_is_passed_where_a_range_is_between_its_bounds(seed: int) -> None:
    dice = random.Random(seed)  # noqa: S311 (a test's dice)
    bounds = [None, *range(MAX_BOUND_M + 1)]
    for _ in range(200):
        ranges_m = [
            dice.choice([round(dice.uniform(0.01, 140), 2), float(dice.randint(1, 140))])
            for _ in range(dice.randint(0, 3))
        ]
        beyond_m, within_m = dice.choice(bounds), dice.choice([None, *bounds[2:]])
        if within_m is not None and beyond_m is not None and within_m <= beyond_m:
            continue
        least, most = beyond_m or 0, float("inf") if within_m is None else within_m
        assert passes(ranges_m, beyond_m, within_m) == any(
            least < range_m <= most for range_m in ranges_m
        )


def test_a_range_of_zero_is_that_of_the_first_metre() -> None:
    assert bits_of([0.0]) == bits_of([1.0]) == (1, 0)


def test_each_metre_has_a_bit_of_its_own_up_to_the_greatest_bound() -> None:
    seen = [bits_of([float(metre)]) for metre in range(1, MAX_BOUND_M + 2)]
    assert len(set(seen)) == MAX_BOUND_M + 1
    assert bits_of([1e9]) == seen[-1]
    assert bits_between(None, None) == (2**63 - 1, 2**63 - 1)


def test_a_request_without_a_range_is_one_that_an_earlier_service_knows() -> None:
    assert b"_m" not in encode(ScenesRequest(vehicle="a"))
    assert b'"within_m":30' in encode(ScenesRequest(within_m=30))
