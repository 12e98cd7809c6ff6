"""Labels of `nuscenes-lidarseg`: a `_lidarseg.bin` for each frame, a byte for each point.

The tables of the folder name the file of each frame and the class of each byte. Those classes do
not name motion: points of a thing that can move have a class and an unknown motion, and those of
surfaces and structures are static.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from schemas.semantickitti import PLAIN
from service.errors import UsageError
from service.export.frames_file import digest_of
from service.export.journal import need_inside
from service.export.labels.exported import ExportedFrame, ExportedScene
from service.export.labels.finished import STATIC, UNKNOWN, FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import of_another_scene, read_bytes, read_json, unlike
from service.export.nuscenes_lidarseg import CLASSES, VERSION

_THING: Final = 99
"""`other-object`: a class of SemanticKITTI for things that nothing moves by itself."""

SEMANTICKITTI: Final[Mapping[str, int]] = {
    **dict.fromkeys(CLASSES, 0),
    **{name: 30 for name in CLASSES if name.startswith("human.")},
    **{name: 20 for name in CLASSES if name.startswith("vehicle.")},
    **{name: _THING for name in CLASSES if name.startswith(("movable_object.", "static_object."))},
    "vehicle.bicycle": 11,
    "vehicle.bus.bendy": 13,
    "vehicle.bus.rigid": 13,
    "vehicle.car": 10,
    "vehicle.motorcycle": 15,
    "vehicle.truck": 18,
    "vehicle.ego": 1,
    "flat.driveable_surface": 40,
    "flat.other": 49,
    "flat.sidewalk": 48,
    "flat.terrain": 72,
    "static.manmade": 50,
    "static.other": _THING,
    "static.vegetation": 70,
}
"""Class of SemanticKITTI for each of nuScenes-lidarseg; `noise` and `animal` have none."""

_PUSHED: Final = frozenset({"movable_object.debris", "movable_object.pushable_pullable"})
"""Things that are moved as often as not: their motion is unknown."""

_STATIC: Final = frozenset(name for name, each in SEMANTICKITTI.items() if each in PLAIN) - _PUSHED


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read the `_lidarseg.bin` of a frame.

    Raises:
        UsageError: If a table or the file cannot be read, if the tables are of another scene, or if
            a byte is no class of the table `category`.
    """
    path = scene.place / _file_of(scene, frame)
    data = read_bytes(path)
    classes = np.frombuffer(data, dtype=np.uint8)
    names = _names(scene.place / VERSION / "category.json")
    for number in np.unique(classes).tolist():
        if names.get(number) not in SEMANTICKITTI:
            raise UsageError(
                f"cannot read labels: class {number} of frame {frame.number} is "
                f"{names.get(number, 'none of the table category')!r}, and no class of "
                f"nuScenes-lidarseg ({path})"
            )
    ids, motion = np.zeros(256, dtype="<u4"), np.full(256, UNKNOWN, dtype=np.uint8)
    for number, name in names.items():
        ids[number] = SEMANTICKITTI.get(name, 0)
        motion[number] = STATIC if name in _STATIC else UNKNOWN
    return FinishedLabels(ids[classes], motion[classes], digest_of(classes))


def _file_of(scene: ExportedScene, frame: ExportedFrame) -> str:
    """Return the path of a frame's labels, as the tables name it."""
    data = _rows(scene.place / VERSION / "sample_data.json")
    labels = _rows(scene.place / VERSION / "lidarseg.json")
    path = scene.place / VERSION / "lidarseg.json"
    try:
        stamp_us = frame.stamp_ns // 1000
        tokens = [each["token"] for each in data if each["timestamp"] == stamp_us]
        files = [each["filename"] for each in labels if each["sample_data_token"] in tokens]
    except (KeyError, TypeError) as error:
        raise unlike("table of nuScenes", error, path) from None
    if len(files) != 1:
        why = f"{len(files)} label files for frame {frame.number} at {stamp_us} µs"
        raise of_another_scene("table of nuScenes", why, path)
    found = str(files[0])
    need_inside(found, what="filename", path=path)
    return found


def _names(path: Path) -> dict[int, str]:
    """Return the name of each class by its number."""
    try:
        names = {int(each["index"]): str(each["name"]) for each in _rows(path)}
    except (KeyError, TypeError, ValueError) as error:
        raise unlike("table of nuScenes", error, path) from None
    return {number: name for number, name in names.items() if 0 <= number < 256}


def _rows(path: Path) -> list[Any]:
    rows = read_json(path, what="table of nuScenes")
    if not isinstance(rows, list):
        raise unlike("table of nuScenes", "it has no rows", path)
    return rows


NUSCENES_LABELS: Final = LabelForm(
    name="nuscenes-lidarseg",
    finished="the files *_lidarseg.bin of each scene",
    exports=("nuscenes-lidarseg",),
    read_frame=read_frame,
)
"""The files that the nuScenes devkit and its evaluation read."""
