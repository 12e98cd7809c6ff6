"""Tiles of a track: what moves changes its place in them, and what stands does not."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.overlay import Overlay
from service.pictures.tiles import TILE_PX, moments_of, views_of
from tests.export_world import FRAMES, overlay, record

STEP_M = 0.5
"""Way of the car from frame to frame."""


def with_boxes(ahead_m: list[float]) -> Overlay:
    """Return the overlay with the box of its track so far ahead of the car in each frame."""
    made = overlay(record())
    boxes = made.instance_boxes.copy()
    boxes[:, 0] = ahead_m
    return replace(made, instance_boxes=boxes)


def centres_px(shown: Overlay, half_m: float) -> NDArray[np.float64]:
    """Return where the box of each moment lies in its tile, pixels."""
    moments = moments_of(np.arange(FRAMES), 1)
    views = views_of(shown, moments, half_m)
    return np.concatenate(
        [
            view.to_px(shown.instance_boxes[each : each + 1, :2])
            for view, each in zip(views, moments, strict=True)
        ]
    )


def test_a_thing_that_stands_lies_at_one_place_while_the_car_passes_it() -> None:
    standing = with_boxes([9 - STEP_M * frame for frame in range(FRAMES)])
    found = centres_px(standing, half_m=6.0)
    np.testing.assert_allclose(found, TILE_PX / 2, atol=0.1)


def test_a_thing_that_moves_lies_elsewhere_in_each_tile() -> None:
    moving = with_boxes([9.0 + 0.5 * frame for frame in range(FRAMES)])
    found = centres_px(moving, half_m=6.0)
    way_px = found[0, 1] - found[-1, 1]
    assert way_px == pytest.approx((FRAMES - 1) * 1.0 * TILE_PX / 12, rel=0.01)
    assert found[:, 0] == pytest.approx(TILE_PX / 2, abs=0.1)


def test_the_window_follows_a_thing_whose_way_is_too_long_for_it() -> None:
    fast = with_boxes([9.0 + 20 * frame for frame in range(FRAMES)])
    np.testing.assert_allclose(centres_px(fast, half_m=6.0), TILE_PX / 2, atol=0.1)
    assert {view.half_m for view in views_of(fast, [0, 3], 6.0)} == {6.0}


def test_a_window_of_one_place_grows_a_little_so_that_the_way_fits() -> None:
    moving = with_boxes([9.0 + 3 * frame for frame in range(FRAMES)])
    views = views_of(moving, [0, 1, 3], 6.0)
    assert 6.0 < views[0].half_m < 10.0
    found = centres_px(moving, half_m=6.0)
    assert ((found > 0) & (found < TILE_PX)).all()


def test_a_track_of_one_frame_has_one_tile() -> None:
    assert moments_of(np.array([2]), 2) == [2]
    (view,) = views_of(overlay(record()), [2], 4.0)
    assert view.frame == 2
