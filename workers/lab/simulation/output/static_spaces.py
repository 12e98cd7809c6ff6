"""Static transforms of a simulated car, as `/tf_static` of ROS 2: where its lidars are mounted."""

from collections.abc import Mapping
from typing import Any, Final

from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Transform
from workers.lab.simulation.output.cloud import STAMP_DEFINITION

TF_STATIC_TOPIC: Final = "/tf_static"
CAR_SPACE: Final = "base_link"
TF_MESSAGE: Final = "tf2_msgs/msg/TFMessage"

_RULE: Final = "=" * 80
TF_DEFINITION: Final = f"""geometry_msgs/TransformStamped[] transforms
{_RULE}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
{_RULE}
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
{_RULE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{_RULE}
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id{STAMP_DEFINITION}"""
"""The message as ROS 2 defines it (geometry2, tf2_msgs/msg/TFMessage.msg)."""


def static_message(placed: Mapping[str, Transform], *, stamp_ns: int) -> dict[str, Any]:
    """Return the message that places sensors in the space of the car.

    Args:
        placed: (4, 4) the car's space from that of each sensor, by the name of its space.
        stamp_ns: Nanoseconds since the Unix epoch.
    """
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    transforms = []
    for space, car_from_sensor in placed.items():
        turn = Rotation.from_matrix(car_from_sensor[:3, :3]).as_quat()
        transforms.append(
            {
                "header": {"stamp": stamp, "frame_id": CAR_SPACE},
                "child_frame_id": space,
                "transform": {
                    "translation": dict(zip("xyz", car_from_sensor[:3, 3].tolist(), strict=True)),
                    "rotation": dict(zip("xyzw", turn.tolist(), strict=True)),
                },
            }
        )
    return {"transforms": transforms}
