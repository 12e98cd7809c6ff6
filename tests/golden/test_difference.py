import numpy as np
import pytest

from tests.golden.difference import near, quantile, relative, same, to_scale

NAN = float("nan")


@pytest.mark.parametrize("compare", [near, relative, to_scale])
@pytest.mark.parametrize(
    "found",
    [
        pytest.param([1.0, 2.1], id="a wrong number"),
        pytest.param([1.0, NAN], id="no number"),
        pytest.param([1.0, np.inf], id="an infinite number"),
        pytest.param([1.0], id="too few"),
        pytest.param([[1.0, 2.0]], id="another shape"),
    ],
)
def test_what_differs_does_not_hold(compare: type, found: list[float]) -> None:
    assert not compare("x", found, [1.0, 2.0], tolerance=0.01).holds
    assert compare("x", [1.0, 2.0], [1.0, 2.0], tolerance=0.0).holds


def test_a_number_where_none_is_expected_does_not_hold() -> None:
    assert near("x", [NAN], [NAN], tolerance=0.0).holds
    assert not near("x", [0.0], [NAN], tolerance=1.0).holds


def test_elements_that_differ_are_counted() -> None:
    assert same("x", [1, 2, 3], [1, 5, 6]).largest == 2
    assert same("x", [1, 2, 3], [1, 5, 6], allowed=2).holds
    assert not same("x", [1, 2], [1, 2, 3], allowed=9).holds


def test_relative_differences_go_by_each_number_and_scaled_ones_by_the_largest() -> None:
    assert relative("x", [1.1, 100], [1, 100], tolerance=1).largest == pytest.approx(0.1)
    assert to_scale("x", [1.1, 100], [1, 100], tolerance=1).largest == pytest.approx(0.001)


def test_a_quantile_leaves_out_the_worst_only() -> None:
    found = np.zeros(100)
    found[0] = 1.0
    assert quantile("x", found, np.zeros(100), share=0.99, tolerance=0.0).holds
    found[1] = 1.0
    assert not quantile("x", found, np.zeros(100), share=0.99, tolerance=0.0).holds
    found[:] = NAN
    assert not quantile("x", found, np.zeros(100), share=0.5, tolerance=9.0).holds
