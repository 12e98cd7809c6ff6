"""Boxes in a Parquet file next to a log: the rows of one shard, as answers in order of time."""

import math
from typing import Any, Final

from schemas.arrays import NS_PER_S
from schemas.predicted_boxes import MAX_BOXES
from schemas.transport.bucket import Bucket
from schemas.visible import visible
from workers.errors import LogUnusableError
from workers.ingest.boxes.stated import StatedBox, StatedBoxes, gather
from workers.ingest.limits import MIB

MAX_FILE_BYTES: Final = 512 * MIB
MAX_OPENED_BYTES: Final = 4096 * MIB
"""Bytes of a file of boxes, stored and as its own index states them opened."""

MAX_ROWS: Final = 500_000
"""Rows of one shard; 200 answers of 120 boxes are 24,000."""

AROUND_NS: Final = NS_PER_S
"""Time around a cloud in which boxes of a file are compared with its stamp, nanoseconds."""

MOST_YAW: Final = 4 * math.pi
"""Largest yaw that is taken for radians: two turns. Degrees soon exceed it."""

UNITS: Final = {"seconds": 10**9, "milliseconds": 10**6, "microseconds": 10**3}
"""Nanoseconds of the units that stamps are mistaken in."""

TOGETHER: Final = (("qx", "qy", "qz", "qw"), ("vx", "vy"))
"""Optional columns of which all are needed, or none."""

NEEDED: Final = ("stamp_ns", "x", "y", "z", "length", "width", "height")
OPTIONAL: Final = (
    *("frame_id", "yaw", "qx", "qy", "qz", "qw", "vx", "vy", "vz"),
    *("class_name", "score", "track_id"),
)


def read_box_file(
    bucket: Bucket, key: str, *, start_ns: int, end_ns: int, clouds_ns: tuple[int, int]
) -> list[StatedBoxes]:
    """Read the boxes of a stretch of time.

    Args:
        bucket: Bucket of predictions.
        key: The file; columns are `NEEDED` and any of `OPTIONAL`.
        start_ns: First stamp.
        end_ns: First stamp after.
        clouds_ns: First and last stamp of clouds about which boxes are read.

    Raises:
        LogUnusableError: If pyarrow is not installed, or the file is no such Parquet.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise LogUnusableError(
            f"boxes in Parquet need pyarrow: pip install 'counterpoint[predictions]' ({key})"
        ) from None
    data = bucket.read_all(key, at_most=MAX_FILE_BYTES)
    try:
        file = parquet.ParquetFile(pa.BufferReader(data))
        names = set(file.schema_arrow.names)
        groups = [file.metadata.row_group(i) for i in range(file.num_row_groups)]
        if sum(group.total_byte_size for group in groups) > MAX_OPENED_BYTES:
            raise LogUnusableError(f"it opens to more than {MAX_OPENED_BYTES} bytes ({key})")
        if missing := [name for name in NEEDED if name not in names]:
            raise LogUnusableError(
                f"the Parquet of boxes lacks the columns {', '.join(missing)}: it needs "
                f"{', '.join(NEEDED)} ({key})"
            )
        for columns in TOGETHER:
            if 0 < len(names & set(columns)) < len(columns):
                raise LogUnusableError(
                    f"the Parquet of boxes has only {', '.join(sorted(names & set(columns)))} of "
                    f"the columns {', '.join(columns)}: write all of them, or none ({key})"
                )
        kind = file.schema_arrow.field("stamp_ns").type
        if not pa.types.is_integer(kind):
            raise LogUnusableError(
                f"stamp_ns is of the type {kind}: it needs whole nanoseconds of the log's clock, "
                f"as int64 ({key})"
            )
        wanted = [name for name in (*NEEDED, *OPTIONAL) if name in names]
        within = [("stamp_ns", ">=", start_ns), ("stamp_ns", "<", end_ns)]
        table = parquet.read_table(pa.BufferReader(data), columns=wanted, filters=within)
        if table.num_rows > MAX_ROWS:
            raise LogUnusableError(
                f"the Parquet of boxes has {table.num_rows} rows within "
                f"{(end_ns - start_ns) / 1e9:.0f} s, more than {MAX_ROWS} ({key})"
            )
        if not _any_within(table, clouds_ns):
            stamps = parquet.read_table(pa.BufferReader(data), columns=["stamp_ns"])
            _need_nanoseconds(stamps, clouds_ns, key)
        rows = table.sort_by("stamp_ns").to_pylist()
    except pa.ArrowException as error:
        raise LogUnusableError(
            f"cannot read boxes: {error}; write the file again ({bucket.url}, {key})"
        ) from None
    return _answers(rows, key)


def _any_within(stamps: Any, clouds_ns: tuple[int, int], *, factor: int = 1) -> bool:
    """Return true if a stamp of a table, in units of `factor` ns, is of the time of the clouds."""
    first, last = (each / factor for each in clouds_ns)
    values = stamps["stamp_ns"].drop_null().to_numpy()
    return bool(((values >= first) & (values <= last)).any())


def _need_nanoseconds(stamps: Any, clouds_ns: tuple[int, int], key: str) -> None:
    """Refuse stamps that would be of the time of the clouds in a coarser unit."""
    for unit, factor in UNITS.items():
        if _any_within(stamps, clouds_ns, factor=factor):
            raise LogUnusableError(
                f"stamp_ns has {unit}: no row is of the time of this log in nanoseconds, in {unit} "
                f"some are; multiply by {factor:,} ({key})"
            )


def _answers(rows: list[dict[str, Any]], key: str) -> list[StatedBoxes]:
    grouped: dict[int, list[StatedBox]] = {}
    frames: dict[int, set[str]] = {}
    for row in rows:
        stamp_ns = int(row["stamp_ns"])
        boxes = grouped.setdefault(stamp_ns, [])
        if not _is_stamp_alone(row):
            boxes.append(_box(row, key))
        frames.setdefault(stamp_ns, set()).add(str(row.get("frame_id") or ""))
    if mixed := [stamp_ns for stamp_ns, names in frames.items() if len(names) > 1]:
        names = ", ".join(map(repr, sorted(frames[mixed[0]])))
        raise LogUnusableError(
            f"{len(mixed)} instants have boxes in several frames, the first ({visible(names)}) at "
            f"{mixed[0]} ns: all rows of a stamp_ns are one answer, in one frame_id ({key})"
        )
    if crowded := [stamp_ns for stamp_ns, boxes in grouped.items() if len(boxes) > MAX_BOXES]:
        raise LogUnusableError(
            f"{len(crowded)} instants have more than {MAX_BOXES} boxes, the first at "
            f"{crowded[0]} ns ({key})"
        )
    return [
        gather(stamp_ns, next(iter(frames[stamp_ns])), boxes) for stamp_ns, boxes in grouped.items()
    ]


def _is_stamp_alone(row: dict[str, Any]) -> bool:
    """Return true for the answer that nothing was found: a row without any number of a box."""
    return all(row[name] is None or math.isnan(row[name]) for name in NEEDED[1:])


def _box(row: dict[str, Any], key: str) -> StatedBox:
    nan = float("nan")

    def numbers(*names: str) -> list[float]:
        return [nan if row[name] is None else float(row[name]) for name in names]

    if row.get("qw") is not None:
        rotation = numbers("qx", "qy", "qz", "qw")
    else:
        half = float(row.get("yaw") or 0.0) / 2
        if abs(2 * half) > MOST_YAW:
            raise LogUnusableError(
                f"a box has the yaw {2 * half:g}: it needs radians, counterclockwise from the "
                f"x-axis; convert degrees ({key})"
            )
        rotation = [0.0, 0.0, math.sin(half), math.cos(half)]
    velocity = None
    if row.get("vx") is not None and row.get("vy") is not None:
        velocity = [float(row["vx"]), float(row["vy"]), float(row.get("vz") or 0.0)]
    score = row.get("score")
    return StatedBox(
        centre_m=numbers("x", "y", "z"),
        rotation=rotation,
        size_m=numbers("length", "width", "height"),
        velocity_m_per_s=velocity,
        score=None if score is None else float(score),
        class_name=str(row.get("class_name") or ""),
        track_id="" if row.get("track_id") is None else str(row["track_id"]),
    )
