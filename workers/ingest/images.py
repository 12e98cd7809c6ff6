"""Images of cameras: their size, and the errors of damaged ones."""

import struct
import zlib
from io import BytesIO
from typing import Final

from PIL import Image

IMAGE_ERRORS: Final = (
    OSError,
    ValueError,
    Image.DecompressionBombError,
    SyntaxError,  # of a damaged PNG
    EOFError,
    struct.error,
    zlib.error,
    KeyError,
    IndexError,
    TypeError,
    OverflowError,
)
"""Errors of Pillow for bytes that are no image, a damaged one, or one of too many pixels."""


def image_size(data: bytes) -> tuple[int, int]:
    """Return width and height of an image, pixels, without decoding it.

    Raises:
        Exception: One of `IMAGE_ERRORS`, if it is no image.
    """
    with Image.open(BytesIO(data)) as opened:
        return opened.size
