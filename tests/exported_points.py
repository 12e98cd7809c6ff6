"""Points of exported scenes, read without our code, and those of the log that they came from."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from mcap_ros2.decoder import DecoderFactory as Ros2
from numpy.typing import NDArray

Points = NDArray[np.float64]
Index = NDArray[np.int64]
Frames = Iterator[tuple[Index, Points]]
"""For each frame the raw place of each written point, and (M, 3) its position in metres."""

_KINDS: Final = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
_FOXGLOVE: Final = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}


def raw_clouds(log: Path, topic: str) -> Mapping[int, Points]:
    """Return (N, 3) of every message of a topic by its header stamp, with NaN as recorded."""
    found: dict[int, Points] = {}
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Ros2()])
        for *_, cloud in reader.iter_decoded_messages(topics=[topic]):
            stamp_ns = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
            kinds = {f.name: (_KINDS[f.datatype], f.offset) for f in cloud.fields}
            found[stamp_ns] = _xyz(_points(bytes(cloud.data), kinds, cloud.point_step))
    return found


def points_of(form: str, place: Path) -> Frames:
    """Yield the points of each frame of an exported scene, in the order of its frames."""
    return READERS[form](place)


def _folder_of_bins(clouds: str, columns: int) -> Callable[[Path], Frames]:
    def read(place: Path) -> Frames:
        for index, cloud in zip(*_sorted(place, "index", clouds), strict=True):
            rows = np.fromfile(cloud, dtype="<f4").reshape(-1, columns)
            yield np.fromfile(index, dtype="<u4").astype(np.int64), rows[:, :3].astype(np.float64)

    return read


def _pcds(clouds: str) -> Callable[[Path], Frames]:
    def read(place: Path) -> Frames:
        from pypcd4.pypcd4 import PointCloud

        for index, path in zip(*_sorted(place, "index", clouds, ".pcd"), strict=True):
            cloud = PointCloud.from_path(path)
            own = cloud.numpy(("index",))[:, 0].astype(np.int64)
            np.testing.assert_array_equal(own, np.fromfile(index, dtype="<u4"))
            yield own, cloud.numpy(("x", "y", "z")).astype(np.float64)

    return read


def _excerpt(path: Path) -> Frames:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Protobuf()])
        for *_, cloud in reader.iter_decoded_messages(topics=["/counterpoint/points"]):
            kinds = {f.name: (_FOXGLOVE[f.type], f.offset) for f in cloud.fields}
            points = _points(cloud.data, kinds, cloud.point_stride)
            yield points["index"].astype(np.int64), _xyz(points) * 1.0


def _recording(path: Path) -> Frames:
    from rerun.chunk import RrdReader

    rows: list[tuple[Any, Index, Points]] = []
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) != "/odom/lidar/points":
            continue
        batch = chunk.to_record_batch()
        columns = [batch.column(name) for name in ("stamp", "index", "Points3D:positions")]
        for stamp, index, positions in zip(*columns, strict=True):
            flat = positions.values.flatten().to_numpy().reshape(-1, 3)
            rows.append((stamp.value, index.values.to_numpy().astype(np.int64), flat.astype("f8")))
    for _, index, points in sorted(rows, key=lambda row: row[0]):
        yield index, points


READERS: Final[Mapping[str, Callable[[Path], Frames]]] = {
    "semantickitti": _folder_of_bins("velodyne", 4),
    "segments": _folder_of_bins("pcd", 4),
    "nuscenes-lidarseg": _folder_of_bins("samples/LIDAR_TOP", 5),
    "cvat": _pcds("pointcloud"),
    "xtreme1": _pcds("lidar_point_cloud_0"),
    "fiftyone": _pcds("."),
    "mcap": _excerpt,
    "rerun": _recording,
}
"""Every format that has points."""


def _sorted(place: Path, first: str, second: str, ending: str = "") -> tuple[list[Path], ...]:
    return sorted((place / first).iterdir()), sorted((place / second).glob(f"*{ending}"))


def _points(data: bytes, kinds: Mapping[str, tuple[str, int]], stride: int) -> NDArray[Any]:
    return np.frombuffer(
        data,
        dtype=np.dtype(
            {
                "names": list(kinds),
                "formats": [kind for kind, _ in kinds.values()],
                "offsets": [offset for _, offset in kinds.values()],
                "itemsize": stride,
            }
        ),
    )


def _xyz(points: NDArray[Any]) -> Points:
    return np.column_stack([points[axis] for axis in "xyz"]).astype(np.float64)
