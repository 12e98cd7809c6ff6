"""Statistics of a scene's clouds that depend on the weather: returns from the air, and others.

No score, track or label depends on them. They describe a scene in its record: rain, spray and snow
return beams in the air next to the sensor, wet surfaces are dark and lose returns, fog is near.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.contradiction import LabelledFrame
from schemas.surroundings import CloudStatistics
from workers.points.compiled import compiled

NEAR_M: Final = 10.0
"""Distance in x, y and, by half, in z within which returns from the air are looked for, metres.

Drops are seen near the sensor; farther away, beams are so far apart that solid things look lone.
"""

CELL_M: Final = 0.5
"""Edge of the cells that are counted, metres: beams at 10 m are some centimetres apart."""

MOST_LONE: Final = 2
"""Returns in a cell and the 26 around it, up to which they count as returned in the air."""

RANGE_STEP_M: Final = 0.1
FARTHEST_M: Final = 400.0
"""Bins of the range, metres; beyond 400 m no lidar of a car sees."""

INTENSITY_STEPS: Final = 1_000
"""Bins of the intensity, which is 0 to 1."""

MOST_RINGS: Final = 512
"""Beams that are counted; a ring beyond is no beam of a lidar on a car."""

SHARE_DIGITS: Final = 5
"""Digits of the shares: two returns in a hundred thousand are seen."""

Counts = NDArray[np.int64]


def cloud_statistics(frames: Sequence[LabelledFrame]) -> CloudStatistics | None:
    """Summarise the clouds of a scene's main lidar; None where it has no return.

    Two milliseconds a frame at most: one pass over the points, and histograms instead of sorting.
    """
    ranges = np.zeros(round(FARTHEST_M / RANGE_STEP_M), np.int64)
    intensities = np.zeros(INTENSITY_STEPS + 1, np.int64)
    sums = np.zeros(4, np.int64)
    for frame in frames:
        cloud = frame.posed.frame.main()  # beams of another lidar are other beams
        count_cloud(
            cloud.points_m, cloud.valid_mask, cloud.intensity, cloud.ring, ranges, intensities, sums
        )
    returns, near, airborne, ways = sums.tolist()
    if not returns:
        return None
    is_bright = bool(intensities[1:].any())
    on_rings = min(returns, ways)
    return CloudStatistics(
        returns=round(returns / len(frames)),
        range_m=round((_median_bin(ranges) + 0.5) * RANGE_STEP_M, 2),
        airborne_share=round(airborne / near, SHARE_DIGITS) if near else 0.0,
        missing_share=round(1.0 - on_rings / ways, SHARE_DIGITS) if ways else None,
        intensity=round(_median_bin(intensities) / INTENSITY_STEPS, 3) if is_bright else None,
    )


def _median_bin(counts: Counts) -> int:
    """Return the bin of the lower median."""
    return int(np.searchsorted(np.cumsum(counts), (int(counts.sum()) + 1) // 2))


@compiled
def count_cloud(
    points_m: Points,
    valid: Mask,
    intensity: NDArray[np.float32],
    ring: NDArray[np.int16],
    ranges: Counts,
    intensities: Counts,
    sums: Counts,
) -> None:
    """Add one cloud to the counts of its scene.

    Args:
        points_m: (N, 3) sensor space, metres.
        valid: (N,) true for returns.
        intensity: (N,) 0 to 1.
        ring: (N,) beam of each; -1 unknown.
        ranges: Returns by range, in steps of `RANGE_STEP_M`; the last bin has all beyond.
        intensities: Returns by intensity, in steps of 1 / `INTENSITY_STEPS`.
        sums: Returns; returns near the sensor; those of them in the air; and firings of all beams
            that return at all, where every return has a ring: as many as the fullest beam has.
    """
    side, high = int(2 * NEAR_M / CELL_M), int(NEAR_M / CELL_M)
    cells = np.zeros((side + 2, side + 2, high + 2), np.int32)
    beams = np.zeros(MOST_RINGS, np.int64)
    returns, near, ringed = 0, 0, 0
    for i in range(len(points_m)):
        if not valid[i]:
            continue
        x, y, z = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        returns += 1
        far = int(np.sqrt(x * x + y * y + z * z) / RANGE_STEP_M)
        ranges[min(far, len(ranges) - 1)] += 1
        intensities[int(intensity[i] * INTENSITY_STEPS + 0.5)] += 1
        if 0 <= ring[i] < MOST_RINGS:
            beams[ring[i]] += 1
            ringed += 1
        if abs(x) < NEAR_M and abs(y) < NEAR_M and abs(z) < NEAR_M / 2:
            near += 1
            a, b = int((x + NEAR_M) / CELL_M), int((y + NEAR_M) / CELL_M)
            cells[a + 1, b + 1, int((z + NEAR_M / 2) / CELL_M) + 1] += 1
    airborne = 0
    for a in range(1, side + 1):
        for b in range(1, side + 1):
            for c in range(1, high + 1):
                if 0 < cells[a, b, c] <= MOST_LONE:
                    around = 0
                    for da in range(-1, 2):
                        for db in range(-1, 2):
                            for dc in range(-1, 2):
                                around += cells[a + da, b + db, c + dc]
                    if around <= MOST_LONE:
                        airborne += cells[a, b, c]
    sums[0] += returns
    sums[1] += near
    sums[2] += airborne
    answering = np.sum(beams > 0)
    if answering > 1 and ringed == returns:
        sums[3] += answering * np.max(beams)
