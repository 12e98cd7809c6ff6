"""Pixels of points worked out at once, against the published formula point by point."""

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.lidar.fidelity import Form
from workers.lidar.range_image import RangeImage, SensorProfile, project

BEAMS = tuple(np.linspace(14.0, -24.0, 64).round(3).tolist())
PROFILES = (
    SensorProfile(name="even", rows=64, columns=512, fov_up_deg=15, fov_down_deg=-25),
    SensorProfile(
        name="beams",
        rows=64,
        columns=2048,
        fov_up_deg=14.3,
        fov_down_deg=-24.3,
        elevations_deg=BEAMS,
    ),
    SensorProfile(name="whole", rows=16, columns=64, fov_up_deg=90, fov_down_deg=-90),
    SensorProfile(name="low", rows=32, columns=512, fov_up_deg=5, fov_down_deg=-5, clamp=True),
)


def cloud(seed: int) -> NDArray[np.float32]:
    """Points all round; some on axes, equal ones, some at the origin or no number."""
    points = np.random.default_rng(seed).normal(0, (30, 30, 4), (6000, 3)).astype(np.float32)
    points[:3000] = np.round(points[:3000])
    points[:20] = 0
    points[20:40] = np.nan
    points[40:80, 1] = 0
    points[60:90, 1] *= -1
    points[100:300] = points[300:500]
    return points


def plainly(
    points: NDArray[np.floating],
    valid: NDArray[np.bool_],
    gate_m: tuple[float, float],
    profile: SensorProfile,
    form: Form,
) -> RangeImage:
    """Project as the published loaders do, in whole arrays."""
    number = points.dtype.type
    x, y, z = points.T
    with np.errstate(invalid="ignore", divide="ignore"):
        range_m = np.sqrt(x * x + y * y + z * z)
        usable = valid & (range_m > number(gate_m[0])) & (range_m < number(gate_m[1]))
        share = number(0.5) * (-np.arctan2(y, x) / number(np.pi) + number(1))
        elevation = np.arcsin(np.clip(z / range_m, -1, 1))
        row = profile.row_of(elevation, clamp=form is Form.PAPER)
        column = np.clip(np.floor(share * number(profile.columns)), 0, profile.columns - 1)
    row[~usable] = -1
    index = np.full((profile.rows, profile.columns), -1, np.int32)
    for i in np.lexsort((-np.arange(len(points)), -range_m)):  # the last to write is the nearest
        if row[i] >= 0:
            index[row[i], int(column[i])] = i
    seen = np.where(index >= 0, range_m[index], -1).astype(np.float32)
    column = np.where(row >= 0, column, -1)
    own = np.where(usable, range_m, 0).astype(np.float32)
    return RangeImage(index, seen, row, column.astype(np.int32), own, form)


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
@pytest.mark.parametrize("precision", [np.float32, np.float64])
@pytest.mark.parametrize("form", Form)
def test_every_point_has_the_pixel_of_the_formula(
    profile: SensorProfile, precision: type[np.float32] | type[np.float64], form: Form
) -> None:
    points = cloud(1)
    valid = np.arange(len(points)) % 9 > 0
    for gate_m in ((0.0, np.inf), (2.0, 50.0)):
        found = project(
            points, profile, valid_mask=valid, gate_m=gate_m, form=form, precision=precision
        )
        wanted = plainly(points.astype(precision), valid, gate_m, profile, form)
        assert found.projected_mask.sum() > 200
        for name in ("index", "range_m", "row", "column", "point_range_m"):
            np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), name)
