"""Real logs with truth of the reference folder, as arrays: what the folders are made of."""

import base64
import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

from schemas.arrays import Transform
from schemas.work import Channel
from workers.ingest.cloud_kinds import is_cloud
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud import DecodedCloud, decode_cloud


@dataclass(frozen=True)
class RealLog:
    """One log and its truth in the reference folder, by the part of both paths."""

    reference: Path
    key: str

    @property
    def path(self) -> Path:
        return self.reference / "data" / "logs" / f"{self.key}.mcap"

    @property
    def truth(self) -> Path:
        return self.reference / "data" / "truth" / self.key

    def clouds(self) -> Iterator[DecodedCloud]:
        return clouds_in(self.path)

    def labels(self, number: int) -> dict[str, NDArray[Any]]:
        with np.load(self.truth / f"{number:06d}.npz") as arrays:
            return dict(arrays)

    def tracks(self) -> list[dict[str, str]]:
        with (self.truth / "tracks.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    def icp_poses(self) -> NDArray[np.float64]:
        with np.load(self.truth / "poses_icp.npz") as arrays:
            poses: NDArray[np.float64] = arrays["world_from_lidar"]
        return poses


def clouds_in(path: Path) -> Iterator[DecodedCloud]:
    """Decode the clouds of a log in any encoding."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if schema is None:
                continue
            known = Channel(
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                schema_name=schema.name,
                schema_encoding=schema.encoding,
                schema_base64=base64.b64encode(schema.data).decode(),
                ids=((0, channel.id),),
            )
            if is_cloud(known):
                yield decode_cloud(RawMessage(known, message.log_time, message.data))


def xyz_of(cloud: DecodedCloud) -> NDArray[np.float64]:
    return np.stack([cloud.fields[name].astype(np.float64) for name in "xyz"], axis=1)


def intensity_of(cloud: DecodedCloud) -> NDArray[np.float32]:
    for name in ("intensity", "i", "reflectance"):
        if name in cloud.fields:
            return cloud.fields[name].astype(np.float32)
    return np.zeros(len(cloud), np.float32)


def wxyz(pose: Transform) -> list[float]:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return [float(w), float(x), float(y), float(z)]
