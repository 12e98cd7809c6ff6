import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from workers.paper import point_sets
from workers.paper.point_sets import (
    find_nearest,
    gather_features,
    gather_points,
    interpolate,
    interpolation,
    sample_furthest,
)


def _points(*shape: int, seed: int = 1, spread: float = 10.0) -> Tensor:
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(seed)) * spread


def _sample_one_by_one(points: NDArray[np.float32], count: int) -> list[int]:
    chosen, nearest = [0], np.full(len(points), np.inf, np.float32)
    while len(chosen) < count:
        way = points - points[chosen[-1]]
        nearest = np.minimum(nearest, (way * way) @ np.ones(3, np.float32))
        chosen.append(int(nearest.argmax()))
    return chosen


def test_sampling_takes_the_furthest_point_each_time() -> None:
    points = _points(2, 300)
    chosen = sample_furthest(points, 40)
    for batch in range(2):
        assert chosen[batch].tolist() == _sample_one_by_one(points[batch].numpy(), 40)


def test_of_equally_far_points_the_lowest_index_is_sampled() -> None:
    corners = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]])
    assert sample_furthest(corners, 5).tolist() == [[0, 1, 2, 3, 4]]


def test_a_sample_in_its_own_order_is_sampled_in_that_order() -> None:
    points = _points(1, 500)
    sampled = gather_points(points, sample_furthest(points, 100))
    assert sample_furthest(sampled, 50).tolist() == [list(range(50))]


def test_more_samples_than_points_repeat_the_first() -> None:
    assert sample_furthest(_points(1, 3), 5)[0, 3:].tolist() == [0, 0]


@pytest.mark.parametrize("chunk", [1, 1000, 1 << 22])
def test_the_nearest_points_are_found_in_order_whatever_fits_into_memory(
    monkeypatch: pytest.MonkeyPatch, chunk: int
) -> None:
    monkeypatch.setitem(point_sets.AT_ONCE, "cpu", chunk)
    queries, points = _points(2, 37), _points(2, 150, seed=2)
    squared, index = find_nearest(queries, points, 9)
    exact = (queries.double()[:, :, None] - points.double()[:, None]).square().sum(dim=3)
    expected = exact.sort(dim=2)
    assert (index == expected.indices[:, :, :9]).all()
    torch.testing.assert_close(squared, expected.values[:, :, :9].float())


def test_of_equally_near_points_the_lowest_indices_are_found() -> None:
    grid = torch.cartesian_prod(*[torch.arange(-3.0, 4.0)] * 3)[None]
    doubled = torch.cat((grid, grid), dim=1)
    _, index = find_nearest(grid, doubled, 10)
    squared = (grid[:, :, None] - doubled[:, None]).square().sum(dim=3)
    assert (index == squared.sort(dim=2, stable=True).indices[:, :, :10]).all()


def test_far_from_the_origin_no_millimetre_is_lost() -> None:
    points = torch.tensor([[[5000.0, 5000, 0], [5000.001, 5000, 0], [5000.003, 5000, 0]]])
    squared, index = find_nearest(points[:, :1], points, 3)
    assert index.tolist() == [[[0, 1, 2]]]
    assert squared.sqrt()[0, 0].tolist() == pytest.approx([0, 0.001, 0.003], abs=3e-4)


def test_no_more_neighbours_are_found_than_there_are() -> None:
    assert find_nearest(_points(1, 4), _points(1, 2), 5)[1].shape == (1, 4, 2)


def test_a_query_on_a_point_takes_its_value_and_between_two_the_mean() -> None:
    points = torch.tensor([[[0.0, 0, 0], [2, 0, 0], [100, 0, 0]]])
    values = torch.tensor([[[1.0, 3.0, 50.0]]])
    queries = torch.tensor([[[0.0, 0, 0], [1, 0, 0]]])
    weights, index = interpolation(queries, points)
    torch.testing.assert_close(weights.sum(dim=2), torch.ones(1, 2))
    found = interpolate(values, weights, index)[0, 0]
    assert found[0] == 1.0
    assert found[1] == pytest.approx(2.0, abs=0.3)


def test_gathering_follows_every_index_of_every_batch() -> None:
    values = torch.arange(24.0).view(2, 3, 4)
    index = torch.tensor([[[0, 3], [1, 1]], [[2, 0], [3, 2]]])
    features = gather_features(values, index)
    rows = gather_points(values.transpose(1, 2), index)
    for batch in range(2):
        expected = values[batch][:, index[batch]]
        assert (features[batch] == expected).all()
        assert (rows[batch] == expected.permute(1, 2, 0)).all()
