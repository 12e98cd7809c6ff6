"""Boxes of KITTI raw: the file `tracklet_labels.xml` of a drive."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from schemas.arrays import Transform
from workers.lab.datasets.conversion.boxes import SourceBox, with_velocities
from workers.lab.datasets.conversion.source import ClassRow, DatasetUnusableError
from workers.lab.datasets.published.files import read_text

CLASSES: Final = (
    ClassRow(1, "Car", 1, movable=True, label=10),
    ClassRow(2, "Van", 1, movable=True, label=10),
    ClassRow(3, "Truck", 4, movable=True, label=18),
    ClassRow(4, "Pedestrian", 6, movable=True, label=30),
    ClassRow(5, "Person (sitting)", 6, movable=True, label=30),
    ClassRow(6, "Cyclist", 7, movable=True, label=31),
    ClassRow(7, "Tram", 5, movable=True, label=16),
    ClassRow(8, "Misc", 5, movable=True, label=20),
)
_ID_OF: Final = {row.name: row.class_id for row in CLASSES}


def read_tracklets(
    path: Path, scans: Mapping[int, Path], poses: Mapping[int, Transform], stamps: Sequence[int]
) -> dict[int, list[SourceBox]]:
    """Read the boxes of each scan, with velocities over the ground.

    Raises:
        DatasetUnusableError: If the file is damaged, or has a class that KITTI does not.
    """
    text = read_text(path)
    if "<!ENTITY" in text:
        raise DatasetUnusableError(f"an XML file with entities is not read: {path}")
    found: dict[int, list[SourceBox]] = {number: [] for number in scans}
    try:
        root = ElementTree.fromstring(text)  # noqa: S314  # without entities nothing grows
        for track, item in enumerate(root.findall("./tracklets/item")):
            name = item.findtext("objectType") or ""
            if name not in _ID_OF:
                raise DatasetUnusableError(
                    f"{path} has the class {name!r}, which is none of KITTI's"
                )
            height, width, length = (float(item.findtext(side) or "") for side in "hwl")
            first = int(item.findtext("first_frame") or "")
            for step, placed in enumerate(item.findall("./poses/item")):
                number = first + step
                if number not in poses:
                    continue
                x, y, z, yaw = (
                    float(placed.findtext(each) or "") for each in ("tx", "ty", "tz", "rz")
                )
                lidar_from_box = np.eye(4)
                lidar_from_box[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
                lidar_from_box[:3, 3] = (x, y, z + height / 2)
                found[number].append(
                    SourceBox(
                        uuid=f"tracklet-{track}",
                        name=name,
                        class_id=_ID_OF[name],
                        movable=True,
                        world_from_box=poses[number] @ lidar_from_box,
                        size_m=(length, width, height),
                    )
                )
    except (ElementTree.ParseError, ValueError) as error:
        raise DatasetUnusableError(f"damaged tracklets: {error} ({path})") from None
    numbers = sorted(found)
    moving = with_velocities([found[n] for n in numbers], [stamps[n] for n in numbers])
    return dict(zip(numbers, moving, strict=True))
