"""Boxes and title on the camera image, and the frame and camera that see the first track."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from schemas.arrays import Mask, Points
from schemas.overlay import Overlay
from schemas.overlay_picture import Picture
from schemas.score import SceneScore
from schemas.sights import corners_m, sights_of
from service.errors import UsageError
from service.pictures.camera_boxes import boxes_of
from service.pictures.scene import draw_camera, frame_of
from service.pictures.strongest_frame import draw_on_camera
from service.pictures.title import labels_of, title_of
from service.settings.config import Settings
from tests.labelled_worlds import labelled_scene
from tests.unit.service.test_picture import (
    AGREED,
    MISSED,
    PHANTOM,
    WALL,
    mined_scene,
)
from tests.unit.service.test_picture import _photo as photo
from tests.unit.service.test_picture import _pixels as pixels_of


@pytest.fixture(scope="module")
def mined() -> tuple[SceneScore, Overlay]:
    return mined_scene(labelled_scene([WALL, AGREED, MISSED, PHANTOM], frames=12))


class _Pinhole:
    """A camera at the sensor that looks ahead, or to the left, of 200 by 100 pixels."""

    def __init__(self, topic: str = "/front", *, left: bool = False) -> None:
        self.topic, self._left = topic, left

    def project(self, points_m: Points) -> tuple[NDArray[np.float64], Mask]:
        x, y, z = points_m.astype(np.float64).T
        ahead, aside = (y, -x) if self._left else (x, y)
        depth = np.where(ahead > 0.1, ahead, 1.0)
        pixels = np.stack([100 - 100 * aside / depth, 50 - 100 * z / depth], axis=1)
        inside = ((pixels >= 0) & (pixels < (200, 100))).all(axis=1)
        return pixels, (ahead > 0.1) & inside


def test_boxes_on_the_camera_have_the_numbers_of_the_picture_from_above(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    number = next(t.track_id for t in score.tracks if t.kind == "only_semantic_dynamic")
    (box,) = boxes_of(overlay, 0, _Pinhole(), labels=labels_of(score), shown_track=number)
    assert box.label == f"{number + 1} pedestrian"
    assert box.is_shown
    assert not box.is_of_witness
    at_px = np.concatenate(box.lines_px)
    corners, _ = _Pinhole().project(corners_m(overlay.instance_boxes[0]))
    assert (at_px.min(axis=0) >= 0).all()
    assert np.abs(at_px.mean(axis=0) - (150, 50)).max() < 12, "12 m ahead and 6 m to the right"
    assert at_px.max(axis=0)[0] <= corners.max(axis=0)[0] + 1
    on_the_left = boxes_of(overlay, 0, _Pinhole(left=True), labels=labels_of(score))
    assert [each.label for each in on_the_left] == [f"{2 - number} car"]


def test_the_first_track_is_looked_for_in_every_camera_and_frame(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    phantom, missed = sorted(score.tracks[:2], key=lambda track: track.kind)[::-1]
    views = [_Pinhole("/front"), _Pinhole("/left", left=True)]
    first = {score.tracks[0].track_id}
    seen = list(sights_of(score.tracks, overlay, views))
    assert {each.track_id for each in seen[:1]} == first
    by_track = {each.track_id: each for each in reversed(seen)}
    assert by_track[phantom.track_id].topic == "/front"
    strongest = frame_of(phantom, overlay)
    assert by_track[phantom.track_id].frame == strongest
    assert by_track[missed.track_id].topic == "/left", "it passes on the left"
    assert list(sights_of(score.tracks, overlay, [])) == []


def test_a_camera_picture_has_its_title_above_and_its_boxes_on_it(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    part = overlay.points_of(0)
    at_px = np.zeros((part.stop, 2))
    boxes = boxes_of(overlay, 0, _Pinhole(), labels=labels_of(score))

    def drawn(**more: Any) -> Image.Image:
        return draw_camera(
            photo(1600, 800),
            overlay,
            frame=0,
            at_px=at_px,
            inside_mask=np.zeros(part.stop, dtype=np.bool_),
            **more,
        )

    bare, boxed = drawn(), drawn(boxes=boxes)
    assert bare.size == boxed.size
    assert (pixels_of(bare) != pixels_of(boxed)).any()
    titled = drawn(boxes=boxes, title=["rank 3 | a@b", "the headline"])
    assert titled.height == boxed.height + 2 * 28 + 10
    assert (pixels_of(titled)[66:] == pixels_of(boxed)).all()


def test_weak_tracks_have_boxes_without_a_number(mined: tuple[SceneScore, Overlay]) -> None:
    score, overlay = mined
    first, *rest = score.tracks
    weak = [track.model_copy(update={"strength": 0.04}) for track in rest]
    lone = score.model_copy(update={"tracks": (first, *weak)})
    assert labels_of(lone) == labels_of(score)[:1]
    assert len(labels_of(score)) > 1
    none = score.model_copy(update={"tracks": tuple(weak)})
    assert labels_of(none) == labels_of(score)[1:2], "the first is named in any case"
    boxes = boxes_of(overlay, 0, _Pinhole(), labels=())
    assert [box.label for box in boxes] == [""]


def _kept(frame: int, *tracks: int) -> Picture:
    return Picture(
        topic=f"/kept/{frame}",
        frame=frame,
        stamp_ns=0,
        width=200,
        height=100,
        media_type="image/png",
        image_bytes=photo(200, 100),
        pixel_from_camera=np.array([[100.0, 0, 100, 0], [0, 100, 50, 0], [0, 0, 1, 0]]),
        camera_from_lidar=np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
        tracks=tracks,
    )


def test_the_picture_kept_with_a_scene_is_drawn_without_its_log(
    mined: tuple[SceneScore, Overlay],
) -> None:
    """Of several that see the first track it is the one nearest to its strongest frame."""
    score, overlay = mined
    strongest = int(overlay.stamps_ns.searchsorted(score.tracks[0].strongest.stamp_ns))
    far = (strongest + 6) % 12
    pictures = (_kept(far, 0, 1), _kept(strongest, 0), _kept((far + 1) % 12, 1))
    both = replace(overlay, pictures=pictures)
    drawn = draw_on_camera(score, both, Settings(), title=title_of(score))
    alone = replace(overlay, pictures=pictures[1:2])
    assert drawn == draw_on_camera(score, alone, Settings(), title=title_of(score))
    other = replace(overlay, pictures=pictures[2:])
    assert drawn != draw_on_camera(score, other, Settings(), title=title_of(score))


def test_without_a_kept_picture_the_bucket_of_the_log_is_needed(
    mined: tuple[SceneScore, Overlay],
) -> None:
    with pytest.raises(UsageError, match=r"no picture was kept .* --bucket URL"):
        draw_on_camera(*mined, Settings(), title=title_of(mined[0]))
