"""PointCloud2 messages of simulated frames, in the format of a ROS 2 driver."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from workers.lab.simulation.faults.recorded import RecordedPoints
from workers.lab.simulation.sensor.lidar import SimulatedFrame

POINT_CLOUD2: Final = "sensor_msgs/msg/PointCloud2"

STAMP_DEFINITION: Final = f"""
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

POINT_CLOUD2_DEFINITION: Final = f"""std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{"=" * 80}
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id{STAMP_DEFINITION}"""
"""The message as ROS 2 defines it (common_interfaces, sensor_msgs/msg/PointCloud2.msg)."""

_DATATYPES: Final = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

_PLACE: Final = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")]
_FIRING: Final = [("t", "<u4"), ("ring", "<u2")]
_LABEL: Final = [("label", "<u2"), ("motion", "<u1"), ("confidence", "<f4")]


def cloud_of(
    frame: SimulatedFrame, recorded: RecordedPoints | None, *, firing: bool = True
) -> NDArray[Any]:
    """Return a frame as the rows of its message, followed by the recorded labels if given.

    Args:
        frame: The frame.
        recorded: Labels of the on-board model.
        firing: Whether each point carries its time and beam.
    """
    named = _PLACE + (_FIRING if firing else []) + (_LABEL if recorded else [])
    rows = np.zeros(len(frame), dtype=np.dtype(named))
    rows["x"], rows["y"], rows["z"] = frame.points_m.T
    rows["intensity"] = frame.intensity
    if firing:
        rows["t"], rows["ring"] = frame.offset_ns, frame.ring
    if recorded is not None:
        _fill_labels(rows, recorded)
    return rows


def labels_of(recorded: RecordedPoints) -> NDArray[Any]:
    """Return the recorded labels as the rows of a message of their own."""
    rows = np.zeros(len(recorded.label), dtype=np.dtype(_LABEL))
    _fill_labels(rows, recorded)
    return rows


def message_of(rows: NDArray[Any], *, stamp_ns: int, space: str) -> dict[str, Any]:
    """Wrap rows in the fields of a PointCloud2, unorganised and dense."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    fields = [
        {
            "name": name,
            "offset": place[1],
            "datatype": _DATATYPES[place[0].str[1:]],
            "count": 1,
        }
        for name, place in (rows.dtype.fields or {}).items()
    ]
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": space},
        "height": 1,
        "width": len(rows),
        "fields": fields,
        "is_bigendian": False,
        "point_step": rows.dtype.itemsize,
        "row_step": rows.nbytes,
        "data": rows.tobytes(),
        "is_dense": True,
    }


def _fill_labels(rows: NDArray[Any], recorded: RecordedPoints) -> None:
    rows["label"], rows["motion"] = recorded.label, recorded.motion
    rows["confidence"] = recorded.confidence
