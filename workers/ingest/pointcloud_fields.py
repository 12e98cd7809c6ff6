"""Point fields: one array per field from the packed bytes of a cloud, for any order and padding."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from workers.errors import CloudUnreadableError

ROS_TYPES: Final[Mapping[int, str]] = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8",
}  # fmt: skip
"""`datatype` of sensor_msgs/PointField."""

FOXGLOVE_TYPES: Final[Mapping[int, str]] = {
    1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8",
}  # fmt: skip
"""`type` of foxglove.PackedElementField."""


@dataclass(frozen=True, slots=True)
class PackedField:
    """Place of one field within the bytes of a point.

    Attributes:
        name: As recorded.
        offset_bytes: From the first byte of the point.
        numpy_type: Kind and size, without byte order: `f4`.
        count: Elements; 0, which some writers leave, means 1.
    """

    name: str
    offset_bytes: int
    numpy_type: str
    count: int = 1

    @property
    def size_bytes(self) -> int:
        """Bytes of all its elements."""
        return int(self.numpy_type[1:]) * max(self.count, 1)


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a cloud's points in its bytes.

    Attributes:
        width: Points of a row.
        height: Rows; 1 for a cloud that is not organised.
        point_step_bytes: From one point to the next.
        row_step_bytes: From one row to the next; 0 where the format has none.
        big_endian: Byte order of the fields.
        fields: In any order.
    """

    width: int
    height: int
    point_step_bytes: int
    row_step_bytes: int
    big_endian: bool
    fields: tuple[PackedField, ...]


def packed_field(
    name: str, *, offset: int, kind: int, count: int, types: Mapping[int, str]
) -> PackedField:
    """Build a field from its numbers in the message.

    Raises:
        CloudUnreadableError: If its type is none of the format's.
    """
    if kind not in types:
        raise CloudUnreadableError(f"cannot read cloud: field {name!r} has unknown type {kind}")
    return PackedField(name, offset, types[kind], count)


def unpack(data: bytes, layout: Layout) -> dict[str, NDArray[Any]]:
    """View the bytes as one array per field; nothing is copied unless rows are padded.

    Args:
        data: The packed points.
        layout: Their layout.

    Returns:
        Name to (N,) array, or (N, count) where a field has several elements; in the byte order
        of the message. The first field of a name wins; nameless fields are padding.

    Raises:
        CloudUnreadableError: If sizes contradict each other: nothing outside `data` is ever read.
    """
    points = layout.width * layout.height
    step = layout.point_step_bytes
    if points == 0:
        if data:
            raise CloudUnreadableError(
                f"cannot read cloud: it has no points but {len(data)} bytes of them"
            )
        return {f.name: np.empty(0, dtype=f.numpy_type) for f in reversed(layout.fields)}
    _check_fields(layout.fields, step)
    row_step = _row_step(len(data), layout)
    order = ">" if layout.big_endian else "<"
    named: dict[str, PackedField] = {}
    for field in layout.fields:
        if field.name:
            named.setdefault(field.name, field)
    dtype = np.dtype(
        {
            "names": list(named),
            "formats": [_format(field, order) for field in named.values()],
            "offsets": [field.offset_bytes for field in named.values()],
            "itemsize": step,
        }
    )
    rows: NDArray[Any] = np.ndarray(
        (layout.height, layout.width), dtype, buffer=data, strides=(row_step, step)
    )
    flat = rows.reshape(points)
    return {name: flat[name] for name in named}


def _format(field: PackedField, order: str) -> Any:
    single = order + field.numpy_type
    return (single, (field.count,)) if field.count > 1 else single


def _check_fields(fields: Sequence[PackedField], step: int) -> None:
    for field in fields:
        if field.offset_bytes + field.size_bytes > step:
            raise CloudUnreadableError(
                f"cannot read cloud: field {field.name!r} ends at byte "
                f"{field.offset_bytes + field.size_bytes} of points of {step} bytes"
            )


def _row_step(size: int, layout: Layout) -> int:
    """Return the bytes from row to row, if they agree with the size of the data.

    The step in the message counts only where it fits: writers of unorganised clouds leave it zero,
    and the padding of the last row may be missing.
    """
    packed = layout.width * layout.point_step_bytes
    if size == packed * layout.height:
        return packed
    stated = layout.row_step_bytes
    if stated > packed and size in (
        stated * layout.height,
        stated * (layout.height - 1) + packed,
    ):
        return stated
    raise CloudUnreadableError(
        f"cannot read cloud: {layout.height} rows of {layout.width} points of "
        f"{layout.point_step_bytes} bytes (row step {stated}) do not fit its {size} bytes"
    )
