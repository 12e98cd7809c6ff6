from dataclasses import replace

import numpy as np
import pytest
import torch

from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import MotionLabel
from workers.lidar.range_image import SensorProfile, project
from workers.lidar.sensor_rows import lay_out
from workers.supervised.classes import ClassMeaning
from workers.supervised.networks import run_network
from workers.supervised.salsanext import SalsaNext
from workers.supervised.stream import RangeImageStream

ANY = SensorProfile(
    name="any", rows=64, columns=256, fov_up_deg=20, fov_down_deg=-30, fitted=True
)  # rows are the most there may be


def _frame(beams_deg: list[float], *, rings: bool = True, steps: int = 256) -> LidarFrame:
    """Beams around a wall 20 m away, fired column by column."""
    azimuth = (np.arange(steps) + 0.5) / steps * 2 * np.pi - np.pi
    az, beam = (each.ravel() for each in np.meshgrid(azimuth, beams_deg, indexing="ij"))
    points = np.stack(
        (20 * np.cos(az), 20 * np.sin(az), 20 * np.tan(np.radians(beam))), axis=1
    ).astype(np.float32)
    ring = np.tile(np.arange(len(beams_deg)), steps).astype(np.int16)
    n = len(points)
    return LidarFrame(
        log_id="wall",
        stamp_ns=10**18,
        points_m=points,
        intensity=np.zeros(n, np.float32),
        offset_ns=np.zeros(n, np.int32),
        ring=ring if rings else np.full(n, -1, np.int16),
        valid_mask=np.ones(n, np.bool_),
    )


CROWDED = [*np.linspace(12, 3, 4), *np.linspace(2, -6, 40), *np.linspace(-8, -25, 4)]


@pytest.mark.parametrize("beams", [CROWDED, np.linspace(10, -25, 32).tolist()])
def test_every_beam_has_a_row_of_its_own_and_every_point_is_seen(beams: list[float]) -> None:
    frame = _frame(beams)
    layout = lay_out(ANY, frame)
    assert layout.rows == len(beams)
    assert not layout.fitted
    assert project(frame.points_m, layout).seen_mask.sum() == len(frame)


def test_more_beams_than_rows_share_evenly_spaced_rows() -> None:
    layout = lay_out(ANY, _frame(np.linspace(15, -25, 128).tolist()))
    assert (layout.rows, layout.elevations_deg) == (64, None)
    assert layout.fov_up_deg == pytest.approx(15, abs=1)


def test_beams_that_cannot_be_told_apart_get_even_rows() -> None:
    layout = lay_out(ANY, _frame(CROWDED, rings=False))
    assert (layout.rows, layout.elevations_deg) == (64, None)


def test_a_profile_that_is_not_fitted_or_a_thin_frame_changes_nothing() -> None:
    fixed = replace(ANY, fitted=False)
    assert lay_out(fixed, _frame(CROWDED)) is fixed
    assert lay_out(ANY, _frame([0.0, -1.0], steps=16)) is ANY


class _Untrained:
    """SalsaNext with random parameters over whatever sensor there is; keeps the images it saw."""

    profile, residual, digest = ANY, None, "none"
    channels = ("range", "x", "y", "z")
    classes = (ClassMeaning(name="thing", moving=True, movable=True), ClassMeaning(name="rest"))

    def __init__(self) -> None:
        torch.manual_seed(1)
        self.net = SalsaNext(in_channels=4, classes=2, width=4).eval()
        self.shapes: list[tuple[int, ...]] = []

    def probabilities(self, image: np.ndarray) -> np.ndarray:
        self.shapes.append(image.shape)
        answer: np.ndarray = run_network(self.net, image[None], "cpu")[0]
        return answer


def test_one_network_reads_sensors_of_any_rows_and_waits_for_a_whole_frame_to_tell_them() -> None:
    for beams, rows in ((CROWDED, 48), (np.linspace(10, -25, 32).tolist(), 32)):
        network = _Untrained()
        stream = RangeImageStream(network, None, name="any")
        thin, whole = _frame([0.0], steps=16), _frame(beams)
        later = replace(whole, stamp_ns=whole.stamp_ns + 10**8)
        first, second, third = stream(
            [PosedFrame(each, np.eye(4)) for each in (thin, whole, later)]
        )
        assert network.shapes == [(4, 64, 256), (4, rows, 256), (4, rows, 256)]
        assert len(first.labels) == 16
        assert (second.labels != MotionLabel.UNKNOWN).all()
        assert np.array_equal(second.labels, third.labels)
