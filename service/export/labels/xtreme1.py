"""Labels of `xtreme1`: the boxes that Xtreme1 returns, in `result/NNNNNN.json` of a scene.

Xtreme1 returns no labels of points. An attribute `moving` of a class states if its object moves.
"""

from typing import Any, Final

from service.export.classes import MOVING_ATTRIBUTE
from service.export.labels.cuboids import (
    MAX_CUBOIDS,
    Cuboid,
    cuboid,
    labels_in_cuboids,
    number_of,
    xyz_of,
)
from service.export.labels.exported import ExportedFrame, ExportedScene
from service.export.labels.exported_points import points_of
from service.export.labels.finished import FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import of_another_scene, read_json, unlike
from service.export.pcd import XTREME1_CLOUDS
from service.export.rotation import rotation_of_angles

_WHAT: Final = "result of Xtreme1"
_BOX: Final = "3D_BOX"


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read the boxes of a frame and label its points; a frame without a file has no labels.

    Raises:
        UsageError: If the file is no result of Xtreme1, if there is one of a frame that the scene
            does not have, or if a class is unknown.
    """
    folder = scene.place / "result"
    known = {f"{each.number:06d}.json" for each in scene.frames}
    for each in folder.glob("*.json"):
        if each.name not in known:
            raise of_another_scene(_WHAT, "the export has no such frame", each)
    path = folder / f"{frame.number:06d}.json"
    if not path.exists():
        return None
    read = read_json(path, what=_WHAT)
    try:
        results = read if isinstance(read, list) else [read]
        boxes = [box for each in results for box in each["objects"] if box["type"] == _BOX]
        if len(boxes) > MAX_CUBOIDS:
            raise ValueError(f"{len(boxes)} boxes in one frame")
        found = [_cuboid(each, scene) for each in boxes]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise unlike(_WHAT, error, path) from None
    return labels_in_cuboids(points_of(scene.place / XTREME1_CLOUDS, frame), found)


def _cuboid(box: dict[str, Any], scene: ExportedScene) -> Cuboid:
    shape = box["contour"]
    told = [
        each["value"]
        for each in box.get("classValues") or ()
        if each.get("name") == MOVING_ATTRIBUTE
    ]
    return cuboid(
        centre_m=xyz_of(shape["center3D"]),
        rotation=rotation_of_angles(xyz_of(shape["rotation3D"]), order="xyz"),
        size_m=xyz_of(shape["size3D"]),
        class_name=str(box["className"]),
        moving=told[0] if told else None,
        number=number_of(str(box.get("trackId") or box["id"]), scene.numbers),
    )


XTREME1_LABELS: Final = LabelForm(
    name="xtreme1",
    finished="result/NNNNNN.json of each scene",
    exports=("xtreme1",),
    read_frame=read_frame,
)
"""The folder `result` of its export."""
