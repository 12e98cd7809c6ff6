"""Compression of kept pictures: as recorded, or smaller."""

from io import BytesIO
from typing import Final

import numpy as np
from PIL import Image

from schemas.overlay_picture import Picture
from workers.ingest.camera_model import CameraView
from workers.ingest.images import IMAGE_ERRORS

SMALL_WIDTH_PX: Final = 640
"""Width of small pictures at most, pixels."""

MAX_PIXELS: Final = 64 * 1024 * 1024
"""Pixels of an image at most; larger ones are not decoded."""

MAX_RECORDED_BYTES: Final = 16 * 1024 * 1024
"""Bytes of a picture that is kept as recorded."""

_QUALITY: Final = 80
_MEDIA_TYPES: Final = {"JPEG": "image/jpeg", "PNG": "image/png"}


class PictureUnreadableError(Exception):
    """The image cannot be decoded, or is too large to be kept."""


def as_recorded(view: CameraView, *, frame: int, tracks: tuple[int, ...]) -> Picture:
    """Return the picture of a camera's image with its recorded bytes.

    Raises:
        PictureUnreadableError: If it is neither JPEG nor PNG, or is too large.
    """
    try:
        with Image.open(BytesIO(view.image_bytes)) as opened:
            media_type = _MEDIA_TYPES.get(opened.format or "")
    except IMAGE_ERRORS as error:
        raise PictureUnreadableError(str(error)) from error
    if media_type is None or len(view.image_bytes) > MAX_RECORDED_BYTES:
        raise PictureUnreadableError(f"{view.image_format} of {len(view.image_bytes)} bytes")
    return _picture(view, view.image_bytes, media_type, (view.width, view.height), frame, tracks)


def smaller(view: CameraView, *, frame: int, tracks: tuple[int, ...]) -> Picture:
    """Return the picture of a camera's image as JPEG, at most 640 pixels wide.

    Raises:
        PictureUnreadableError: If the image cannot be decoded, or is too large.
    """
    scale = min(1.0, SMALL_WIDTH_PX / view.width)
    size = (max(1, round(view.width * scale)), max(1, round(view.height * scale)))
    try:
        with Image.open(BytesIO(view.image_bytes)) as opened:
            if opened.width * opened.height > MAX_PIXELS:
                raise PictureUnreadableError(f"{opened.width} x {opened.height} pixels")
            opened.draft("RGB", size)  # a JPEG is decoded at the next larger eighth
            image = opened.convert("RGB").resize(size, Image.Resampling.BILINEAR)
        out = BytesIO()
        image.save(out, format="JPEG", quality=_QUALITY)
    except IMAGE_ERRORS as error:
        raise PictureUnreadableError(str(error)) from error
    return _picture(view, out.getvalue(), "image/jpeg", size, frame, tracks)


def _picture(
    view: CameraView,
    image_bytes: bytes,
    media_type: str,
    size: tuple[int, int],
    frame: int,
    tracks: tuple[int, ...],
) -> Picture:
    scale = np.diag((size[0] / view.width, size[1] / view.height, 1.0))
    try:
        return Picture(
            topic=view.topic,
            frame=frame,
            stamp_ns=view.stamp_ns,
            width=size[0],
            height=size[1],
            media_type=media_type,
            image_bytes=image_bytes,
            pixel_from_camera=scale @ view.pixel_from_camera,
            camera_from_lidar=np.array(view.camera_from_lidar, dtype=np.float64),
            distortion_model=view.distortion_model if view.distortion else "",
            distortion=view.distortion,
            tracks=tracks,
        )
    except ValueError as error:
        raise PictureUnreadableError(str(error)) from error
