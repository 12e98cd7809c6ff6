"""Pixel windows in a range image, compiled: nearest neighbours, votes and means around points."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from workers.points.compiled import compiled

Pixels = NDArray[np.int32]
Codes = NDArray[np.uint8]
Values = NDArray[np.float32]

_BLOCK = 256
"""Points at a time: the working set of a block stays in the nearest caches."""

_PLACE_BITS = 16
_NOWHERE = np.int64(np.float32(np.inf).view(np.int32)) << _PLACE_BITS
"""Key of no pixel: infinite distance, in the first place of a window."""

Number = TypeVar("Number", bound=np.generic)


@compiled
def padded(values: Values, index: Pixels, reach: int, fill: np.float32, wrap: bool) -> Values:
    """Pad an image on all sides; empty pixels, of index -1, become infinite.

    Args:
        values: (H, W).
        index: (H, W) below zero where a pixel is empty.
        reach: Pixels on each side.
        fill: Value beyond the image.
        wrap: Continue the image from its other side on the left and right instead.

    Returns:
        (H + 2 reach, W + 2 reach).
    """
    rows, columns = values.shape
    wide = np.full((rows + 2 * reach, columns + 2 * reach), fill, np.float32)
    for row in range(rows):
        for place in range(columns + 2 * reach):
            column = place - reach
            if wrap:
                column %= columns
            if 0 <= column < columns:
                empty = index[row, column] < 0
                wide[row + reach, place] = np.float32(np.inf) if empty else values[row, column]
    return wide


@compiled
def nearest_in_window(
    wide: Values,
    row: Pixels,
    column: Pixels,
    own: Values,
    points: NDArray[np.int64],
    discount: Values,
    neighbours: int,
    cutoff: np.float32,
    wrap: bool,
) -> Pixels:
    """Find the pixels in the window of each point that are nearest in discounted range.

    Args:
        wide: Ranges from `padded`.
        row: (N,) of each point.
        column: (N,) of each point.
        own: (N,) range of each point.
        points: (M,) indices of the query points.
        discount: (S, S) factor of each place in the window; S is odd.
        neighbours: Number of pixels per point.
        cutoff: Largest discounted distance.
        wrap: The first column continues the last.

    Returns:
        (M, neighbours) flat pixels, nearest first, of equals the first in the window; -1 for none,
        or for one beyond the image.
    """
    side = len(discount)
    reach = side // 2
    rows, columns = wide.shape[0] - 2 * reach, wide.shape[1] - 2 * reach
    flat = wide.ravel()
    steps = np.arange(side * side)
    down_of, along_of = steps // side - reach, steps % side - reach
    found = np.full((len(points), neighbours), -1, np.int32)
    # range and place of a pixel as one number, so that the least is found without a branch
    key = np.empty((side * side, _BLOCK), np.int64)
    apart = np.empty(_BLOCK, np.float32)
    bits = apart.view(np.int32)  # of what is not negative, in the same order
    best, last = np.empty(_BLOCK, np.int64), np.empty(_BLOCK, np.int64)
    range_m, corner = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.int32)
    for begin in range(0, len(points), _BLOCK):
        n = min(_BLOCK, len(points) - begin)
        for k in range(n):
            i = points[begin + k]
            range_m[k], corner[k] = own[i], row[i] * wide.shape[1] + column[i]
        for step in range(side * side):
            offset = np.int32(step // side * wide.shape[1] + step % side)
            factor = discount[step // side, step % side]
            for k in range(n):
                apart[k] = abs(flat[corner[k] + offset] - range_m[k]) * factor
            if step == side * side // 2:
                apart[:n] = 0.0  # the centre is the point itself
            for k in range(n):
                key[step, k] = (np.int64(bits[k]) << _PLACE_BITS) | step
        last[:n] = -1
        for neighbour in range(neighbours):
            best[:n] = _NOWHERE
            for step in range(side * side):
                _keep_least(key[step], n, last, best)
            for k in range(n):
                bits[k] = np.int32(best[k] >> _PLACE_BITS)
                if apart[k] <= cutoff:
                    i, step = points[begin + k], best[k] & ((1 << _PLACE_BITS) - 1)
                    down, along = row[i] + down_of[step], column[i] + along_of[step]
                    if wrap:
                        along += columns * (int(along < 0) - int(along >= columns))
                    if 0 <= down < rows and 0 <= along < columns:
                        found[begin + k, neighbour] = down * columns + along
            last[:n] = best[:n]
    return found


@compiled
def _keep_least(
    key: NDArray[np.int64], n: int, last: NDArray[np.int64], best: NDArray[np.int64]
) -> None:
    """Keep the least number above the last one."""
    for k in range(n):
        after = key[k] if key[k] > last[k] else _NOWHERE
        best[k] = after if after < best[k] else best[k]


@compiled
def look_up(image: NDArray[Number], pixel: Pixels, nothing: Number) -> NDArray[Number]:
    """Return the value of each point's pixel in (H, W), or `nothing` for pixel -1; (N,)."""
    flat = image.ravel()
    found = np.empty(len(pixel), image.dtype)
    for i in range(len(pixel)):
        found[i] = flat[pixel[i]] if pixel[i] >= 0 else nothing
    return found


@compiled
def majority_code(image: Codes, voters: Pixels, without_votes: np.uint8) -> Codes:
    """Return the commonest code above 0 among the voting pixels, the lowest of equals.

    Args:
        image: (H, W) codes.
        voters: (M, k) flat pixels, -1 for none.
        without_votes: Result without votes.

    Returns:
        (M,) codes.
    """
    flat = image.ravel()
    winners = np.empty(len(voters), np.uint8)
    votes = np.zeros(256, np.int64)
    for m in range(len(voters)):
        winner, most = without_votes, 0
        for pixel in voters[m]:
            code = flat[pixel] if pixel >= 0 else np.uint8(0)
            if code > 0:
                votes[code] += 1
                if votes[code] > most or (votes[code] == most and code < winner):
                    winner, most = code, votes[code]
        for pixel in voters[m]:
            if pixel >= 0:
                votes[flat[pixel]] = 0
        winners[m] = winner
    return winners


@compiled
def mean_of(image: Values, voters: Pixels) -> Values:
    """Average the voting pixels, summed in float64; 0 without votes.

    Args:
        image: (H, W).
        voters: (M, k) flat pixels, -1 for none.

    Returns:
        (M,) float32.
    """
    flat = image.ravel()
    means = np.zeros(len(voters), np.float32)
    for m in range(len(voters)):
        total, count = 0.0, 0
        for pixel in voters[m]:
            if pixel >= 0:
                total += np.float64(flat[pixel])
                count += 1
        means[m] = total / max(count, 1)
    return means


@compiled
def mixed_windows(codes: Codes, index: Pixels, reach: int, wrap: bool) -> NDArray[np.bool_]:
    """Find pixels whose window contains more than one code, or code 0.

    Args:
        codes: (H, W) of each pixel.
        index: (H, W) below zero where a pixel is empty.
        reach: Pixels of the window on each side.
        wrap: The first column continues the last.

    Returns:
        (H, W).
    """
    rows, columns = codes.shape
    lowest, highest = np.empty((2, rows, columns), np.uint8)
    for row in range(rows):
        for column in range(columns):
            low, high = np.uint8(255), np.uint8(0)
            for step in range(-reach, reach + 1):
                at = column + step
                if wrap:
                    at %= columns
                elif at < 0 or at >= columns:
                    continue
                if index[row, at] >= 0:
                    low, high = min(low, codes[row, at]), max(high, codes[row, at])
            lowest[row, column], highest[row, column] = low, high
    mixed = np.empty((rows, columns), np.bool_)
    for row in range(rows):
        first, last = max(row - reach, 0), min(row + reach + 1, rows)
        for column in range(columns):
            low, high = np.uint8(255), np.uint8(0)
            for at in range(first, last):
                low, high = min(low, lowest[at, column]), max(high, highest[at, column])
            mixed[row, column] = low != high or low == 0
    return mixed


@compiled
def argmax_code(values: Values) -> Codes:
    """Return the 1-based argmax over K of (K, P) values, the first of equals; (P,)."""
    count, pixels = values.shape
    best = np.ones(pixels, np.uint8)
    most = values[0].copy()
    for k in range(1, count):
        value, code = values[k], np.uint8(k + 1)
        for p in range(pixels):  # without a branch, for vector instructions
            more = value[p] > most[p]
            best[p] = code if more else best[p]
            most[p] = value[p] if more else most[p]
    return best
