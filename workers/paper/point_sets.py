"""Point set operations in plain torch: furthest point sampling, nearest neighbours, interpolation.

FlowStep3D needs them as in PointNet++ (Qi et al., NeurIPS 2017). Distances are sums of squared
differences, never `|a|^2 - 2ab + |b|^2`: far from the origin, that form loses centimetres. Memory
is bounded: at most `distances_at_once` exist at a time.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from workers.points.compiled import compiled

AT_ONCE: Final[dict[str, int]] = {"cpu": 1 << 22, "cuda": 1 << 26}
"""Distances in memory at a time: 16 MiB in float32, and 256 MiB where parts wait for each other."""

NEAREST_M: Final = 1e-10
"""Smallest distance in interpolation, so that a point on a sample takes its value; published."""


def sample_furthest(points: Tensor, count: int) -> Tensor:
    """Sample points by furthest point sampling: each is the furthest from all before it.

    Starts with index 0; of equally far points the lowest index is taken. If `count` exceeds the
    number of points, index 0 repeats once no distance is left. Each point depends on the one
    before, which a GPU waits for: the processor samples, a thread of torch's number per cloud.

    Args:
        points: (B, N, 3).
        count: Number of samples.

    Returns:
        (B, count) int64 indices, in the order they were chosen.
    """
    clouds = np.ascontiguousarray(points.detach().cpu().numpy(), np.float32)
    rows = np.zeros((len(clouds), count), np.int64)
    with ThreadPoolExecutor(torch.get_num_threads()) as threads:
        list(threads.map(_sample_furthest, clouds, rows))
    return torch.from_numpy(rows).to(points.device)


@compiled
def _sample_furthest(points: NDArray[np.float32], chosen: NDArray[np.int64]) -> None:
    """Fill (count,) indices into (N, 3) points; the first stays 0."""
    nearest = np.full(len(points), np.inf, np.float32)
    last = 0
    for place in range(1, len(chosen)):
        x, y, z = points[last, 0], points[last, 1], points[last, 2]
        furthest, last = np.float32(-1.0), 0
        for number in range(len(points)):
            along_x, along_y = points[number, 0] - x, points[number, 1] - y
            along_z = points[number, 2] - z
            far = along_x * along_x + along_y * along_y + along_z * along_z
            nearest[number] = min(nearest[number], far)
            if nearest[number] > furthest:
                furthest, last = nearest[number], number
        chosen[place] = last


def distances_at_once(points: Tensor) -> int:
    """Return the number of distances to hold in memory at a time, on the device of these points."""
    return AT_ONCE[points.device.type]


def squared_distances(queries: Tensor, points: Tensor) -> Tensor:
    """Return the squared distance from every query to every point, by differences.

    Args:
        queries: (B, M, 3).
        points: (B, N, 3).

    Returns:
        (B, M, N), square of the unit of the points.
    """
    total = (queries[:, :, None, 0] - points[:, None, :, 0]).square_()
    for axis in (1, 2):
        total.add_((queries[:, :, None, axis] - points[:, None, :, axis]).square_())
    return total


@torch.no_grad()
def find_nearest(queries: Tensor, points: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Find the nearest points of each query, nearest first; of equally near ones the lowest index.

    There is no gradient: the choice of neighbours is not differentiable.

    Args:
        queries: (B, M, 3).
        points: (B, N, 3), not empty.
        count: Number of neighbours; at most N are found.

    Returns:
        (B, M, min(count, N)) squared distances, and int64 indices of the points.
    """
    batch, wanted, found = *queries.shape[:2], points.shape[1]
    count, rows = min(count, found), max(1, distances_at_once(points) // (batch * found))
    squared = queries.new_empty(batch, wanted, count)
    index = torch.empty(batch, wanted, count, dtype=torch.int64, device=queries.device)
    # the same memory for every part: results between freed parts would keep it from being reused
    scratch = queries.new_empty(2, batch, min(rows, wanted), found)
    for start in range(0, wanted, rows):
        part = slice(start, start + rows)
        squared[:, part], index[:, part] = _nearest(queries[:, part], points, count, scratch)
    return squared, index


def _nearest(queries: Tensor, points: Tensor, count: int, scratch: Tensor) -> tuple[Tensor, Tensor]:
    """Search by selection, and again by sorting for queries with ties, which selection ignores."""
    distances, along = scratch[:, :, : queries.shape[1]]
    torch.sub(queries[:, :, None, 0], points[:, None, :, 0], out=distances).square_()
    for axis in (1, 2):
        torch.sub(queries[:, :, None, axis], points[:, None, :, axis], out=along).square_()
        distances += along
    one_more = min(count + 1, points.shape[1])
    best, index = distances.topk(one_more, dim=2, largest=False)
    tied = (best[:, :, 1:] == best[:, :, :-1]).any(dim=2)
    best, index = best[:, :, :count].contiguous(), index[:, :, :count].contiguous()
    if tied.any():
        sorted_, order = distances[tied].sort(dim=1, stable=True)
        best[tied], index[tied] = sorted_[:, :count], order[:, :count]
    return best, index


def gather_points(values: Tensor, index: Tensor) -> Tensor:
    """Take rows by index.

    Args:
        values: (B, N, C).
        index: (B, ...) int64 into N.

    Returns:
        (B, ..., C).
    """
    batch, count, channels = values.shape
    starts = torch.arange(batch, device=index.device) * count
    rows = (index.flatten(start_dim=1) + starts[:, None]).flatten()
    return values.reshape(-1, channels).index_select(0, rows).view(*index.shape, channels)


def gather_features(values: Tensor, index: Tensor) -> Tensor:
    """Take columns by index.

    Args:
        values: (B, C, N).
        index: (B, ...) int64 into N.

    Returns:
        (B, C, ...).
    """
    flat = index.flatten(start_dim=1)[:, None, :].expand(-1, values.shape[1], -1)
    return values.gather(2, flat).view(*values.shape[:2], *index.shape[1:])


def interpolation(queries: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Return inverse-distance weights of the three nearest points of each query.

    Args:
        queries: (B, M, 3).
        points: (B, N, 3), not empty; with fewer than three, all of them.

    Returns:
        (B, M, 3) weights that sum to 1, and int64 indices of the points.
    """
    squared, index = find_nearest(queries, points, 3)
    inverse = squared.sqrt_().clamp_(min=NEAREST_M).reciprocal_()
    return inverse / inverse.sum(dim=2, keepdim=True), index


def interpolate(values: Tensor, weights: Tensor, index: Tensor) -> Tensor:
    """Interpolate values from points to queries.

    Args:
        values: (B, C, N) at the points.
        weights: (B, M, 3) of `interpolation`.
        index: (B, M, 3) of `interpolation`.

    Returns:
        (B, C, M) at the queries.
    """
    carried = gather_features(values, index[:, :, 0]) * weights[:, None, :, 0]
    for nearest in range(1, index.shape[2]):
        carried += gather_features(values, index[:, :, nearest]) * weights[:, None, :, nearest]
    return carried
