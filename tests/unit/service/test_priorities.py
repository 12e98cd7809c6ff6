"""Priorities as they are written, and the turns in which they order claims."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.curation.priorities import Priorities, Priority
from service.store.turns import LAST_LANE, NO_LIMIT, Kind, in_lane, lane_of, stretches, turn_of

KINDS = st.sampled_from(Kind)
LANES = st.integers(0, LAST_LANE)
TIMES = st.floats(0, 2**34 - 1)


@pytest.mark.parametrize("written", ["car=", "car=0", "car=101%", "=4", "car=x", "car=-1", "a=1.5"])
def test_a_limit_that_is_none_is_refused(written: str) -> None:
    with pytest.raises(ValueError, match="PATTERN=4"):
        Priority.parse(written)


def test_limits_are_leases_or_a_share() -> None:
    assert Priority.parse("car-[1-3]") == Priority("car-[1-3]")
    assert Priority.parse("test/*=4") == Priority("test/*", most_leases=4)
    assert Priority.parse("a=b=25%") == Priority("a=b", most_share=0.25)


def test_the_first_entry_that_matches_counts_for_path_or_vehicle() -> None:
    order = Priorities.parse(["eu/*/car-7/*", "car-7", "others", "test/*"])
    assert order.place_of("eu/2026/car-7/x", "car-7") == 0
    assert order.place_of("us/x", "car-7") == 1
    assert order.place_of("us/x", "car-8") == 2
    assert order.place_of("test/x", "car-8") == 3
    assert Priorities.parse(["a"]).place_of("b", "c") == 1


def test_others_are_named_once() -> None:
    with pytest.raises(ValueError, match="once"):
        Priorities.parse(["others", "others=3"])


@given(KINDS, KINDS, LANES, LANES, TIMES, TIMES)
def test_turns_order_by_kind_then_lane_then_time(
    one: Kind, other: Kind, lane: int, other_lane: int, time: float, other_time: float
) -> None:
    turn = turn_of(one, newest_s=time, lane=lane)
    later = turn_of(other, newest_s=other_time, lane=other_lane)
    if (one, lane) < (other, other_lane):
        assert turn < later
    assert lane_of(turn) == lane
    assert in_lane(turn, other_lane) == turn_of(one, newest_s=time, lane=other_lane)


def test_turns_of_a_former_state_are_those_of_no_priority() -> None:
    assert turn_of(Kind.NEW) == 0
    assert turn_of(Kind.REST, newest_s=1.7e9) == (4 << 40) + 2**40 - 1 - 1_700_000_000


@given(KINDS, LANES, TIMES, st.sets(LANES, max_size=5))
def test_open_stretches_leave_out_full_lanes_alone(
    kind: Kind, lane: int, time: float, full: set[int]
) -> None:
    turn = turn_of(kind, newest_s=time, lane=lane)
    found = list(stretches(full))
    assert any(first <= turn < after for first, after in found) == (lane not in full)
    assert found == sorted(found)
    assert found[-1][1] == NO_LIMIT
    only = list(stretches((), of=full)) if full else []
    assert any(first <= turn < after for first, after in only) == (lane in full)
    limited = list(stretches(full, below=Kind.CANARY.first_turn))
    assert all(after <= Kind.CANARY.first_turn for _, after in limited)
