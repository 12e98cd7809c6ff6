"""ROS message types that are read here, with their definitions of ROS 1 and ROS 2.

These types have not changed on the wire for as long as MCAP exists, so the definition in a log is
not needed. Without it, logs whose schema is written in IDL can be read as well. The ROS 1 decoder,
which turns a definition into Python code and runs it, never receives text from a log.

Sources: docs.ros.org, common_interfaces and geometry2 of ROS 1 Noetic and ROS 2 Humble.
"""

from typing import Final

_SEPARATOR: Final = "\n" + "=" * 80 + "\n"

_ROS1_HEADER: Final = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id"
_ROS2_HEADER: Final = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"

_POINT_CLOUD2: Final = """\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense"""
_POINT_FIELD: Final = """\
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count"""

_COMPRESSED_IMAGE: Final = "std_msgs/Header header\nstring format\nuint8[] data"

_CAMERA_INFO: Final = """\
std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] {d}
float64[9] {k}
float64[9] {r}
float64[12] {p}
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi"""
_REGION_OF_INTEREST: Final = """\
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify"""

_NAV_SAT_FIX: Final = (
    "std_msgs/Header header\nsensor_msgs/NavSatStatus status\n"
    "float64 latitude\nfloat64 longitude\nfloat64 altitude\n"
    "float64[9] position_covariance\nuint8 position_covariance_type"
)
_NAV_SAT_STATUS: Final = "MSG: sensor_msgs/NavSatStatus\nint8 status\nuint16 service"

_TF_MESSAGE: Final = "geometry_msgs/TransformStamped[] transforms"
_TRANSFORM_PARTS: Final = (
    "MSG: geometry_msgs/TransformStamped\n"
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    "MSG: geometry_msgs/Transform\n"
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
)

_POSE_PARTS: Final = (
    "MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance",
    "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
    _TRANSFORM_PARTS[3],
)
_TWIST_PARTS: Final = (
    "MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance",
    "MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    _TRANSFORM_PARTS[2],
)
_ODOMETRY: Final = (
    "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
)


def _stamped(name: str) -> str:
    return f"std_msgs/Header header\ngeometry_msgs/{name} {name[:5].lower()}"


def _definitions(header: str, *, camera: dict[str, str]) -> dict[str, str]:
    camera_info = _CAMERA_INFO.format(**camera)
    return {
        "sensor_msgs/PointCloud2": _SEPARATOR.join((_POINT_CLOUD2, header, _POINT_FIELD)),
        "sensor_msgs/CompressedImage": _SEPARATOR.join((_COMPRESSED_IMAGE, header)),
        "sensor_msgs/CameraInfo": _SEPARATOR.join((camera_info, header, _REGION_OF_INTEREST)),
        "sensor_msgs/NavSatFix": _SEPARATOR.join((_NAV_SAT_FIX, header, _NAV_SAT_STATUS)),
        "nav_msgs/Odometry": _SEPARATOR.join((_ODOMETRY, header, *_POSE_PARTS, *_TWIST_PARTS)),
        "geometry_msgs/TwistStamped": _SEPARATOR.join((_stamped("Twist"), header, *_TWIST_PARTS)),
        "geometry_msgs/TwistWithCovarianceStamped": _SEPARATOR.join(
            (_stamped("TwistWithCovariance"), header, *_TWIST_PARTS)
        ),
        "tf2_msgs/TFMessage": _SEPARATOR.join((_TF_MESSAGE, header, *_TRANSFORM_PARTS)),
    }


ROS1_DEFINITIONS: Final = _definitions(
    _ROS1_HEADER, camera={"d": "D", "k": "K", "r": "R", "p": "P"}
)
ROS2_DEFINITIONS: Final = _definitions(
    _ROS2_HEADER, camera={"d": "d", "k": "k", "r": "r", "p": "p"}
)
"""Type name without `/msg/` to its definition, with the definitions of its members appended."""
