import pytest

from workers.lab.evaluation.benchmarks.network_time import times_as_fast


def test_a_ratio_is_that_of_pairs() -> None:
    assert times_as_fast([2.0, 20.0, 6.0], [1.0, 10.0, 2.0]) == pytest.approx(2.0)
