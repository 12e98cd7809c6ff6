"""Container of named arrays and JSON metadata: compressed, checksummed and reproducible."""

import json
import struct
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from schemas.canonical import canonical_json
from schemas.errors import PermanentError

MAX_UNPACKED_BYTES: Final = 2**30
"""Maximum size of an unpacked container; one that claims more is refused before decompression."""

_LENGTH: Final = struct.Struct("<I")
_DTYPES: Final = frozenset({"|i1", "|u1", "|b1", "<i2", "<u2", "<i4", "<i8", "<f4", "<f8"})
_LEVEL: Final = 1  # level 3 costs twice the time for 6 % of an overlay


class PackUnreadableError(PermanentError):
    """The bytes are not a pack, are damaged, or claim to be larger than any pack."""


def pack(magic: bytes, meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack arrays and their metadata; equal input gives equal bytes.

    Args:
        magic: First bytes, which give kind and version.
        meta: Plain data, encoded as canonical JSON.
        arrays: Name to array, of integers, floats or booleans; stored little-endian.

    Raises:
        ValueError: If an array has a type that is not stored, or the pack would be too large.
    """
    body = joined(meta, arrays)
    return magic + zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(body)


def joined(meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Join arrays and their metadata, uncompressed; equal input gives equal bytes.

    Raises:
        ValueError: If an array has a type that is not stored, or the whole would be too large.
    """
    stored = {
        name: np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        for name, array in sorted(arrays.items())
    }
    unknown = {name: a.dtype.str for name, a in stored.items() if a.dtype.str not in _DTYPES}
    if unknown:
        raise ValueError(f"cannot pack arrays of these types: {unknown}")
    header = canonical_json(
        {
            "meta": dict(meta),
            "arrays": [[name, a.dtype.str, list(a.shape)] for name, a in stored.items()],
        }
    )
    body = b"".join([_LENGTH.pack(len(header)), header, *(a.tobytes() for a in stored.values())])
    if len(body) > MAX_UNPACKED_BYTES:
        raise ValueError(f"pack of {len(body)} bytes exceeds {MAX_UNPACKED_BYTES}")
    return body


def unpack(magic: bytes, payload: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Unpack the output of `pack`; the arrays are read-only.

    Raises:
        PackUnreadableError: If the bytes have another kind, are damaged, or are too large.
    """
    if not payload.startswith(magic):
        raise PackUnreadableError(
            f"expected {magic!r} at the start, found {bytes(payload[: len(magic)])!r}"
        )
    frame = memoryview(payload)[len(magic) :]
    try:
        size = zstandard.frame_content_size(frame)
        if not 0 <= size <= MAX_UNPACKED_BYTES:
            raise PackUnreadableError(f"claims {size} bytes, more than {MAX_UNPACKED_BYTES}")
        body = memoryview(zstandard.ZstdDecompressor().decompress(frame, max_output_size=size))
    except zstandard.ZstdError as error:
        raise PackUnreadableError(f"damaged: {error}") from error
    return parted(body)


def parted(body: memoryview) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what `joined` joined; the arrays are read-only.

    Raises:
        PackUnreadableError: If the bytes are damaged.
    """
    try:
        (length,) = _LENGTH.unpack_from(body, 0)
        at = _LENGTH.size + length
        header = json.loads(bytes(body[_LENGTH.size : at]))
        meta, listed = header["meta"], header["arrays"]
        arrays: dict[str, NDArray[Any]] = {}
        for name, dtype, shape in listed:
            if dtype not in _DTYPES or any(side < 0 for side in shape):
                raise PackUnreadableError(f"damaged: array {name!r} of {dtype!r} {shape!r}")
            count = int(np.prod(shape, dtype=object)) if shape else 1
            arrays[name] = np.frombuffer(body, dtype, count=count, offset=at).reshape(shape)
            at += arrays[name].nbytes
    except (KeyError, TypeError, ValueError, struct.error) as error:
        raise PackUnreadableError(f"damaged: {error}") from error
    return meta, arrays
