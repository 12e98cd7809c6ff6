"""Labels of `cvat`: the cuboids that CVAT returns as `Datumaro 3D`, in `annotations` of a scene.

CVAT 3D labels no points. An attribute `moving` of a label states if its object moves.
"""

from pathlib import Path
from typing import Any, Final

from service.errors import UsageError
from service.export.classes import MOVING_ATTRIBUTE
from service.export.labels.cuboids import (
    MAX_CUBOIDS,
    Cuboid,
    cuboid,
    labels_in_cuboids,
    number_of,
)
from service.export.labels.exported import ExportedFrame, ExportedScene
from service.export.labels.exported_points import points_of
from service.export.labels.finished import FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import of_another_scene, read_json, unlike
from service.export.pcd import CVAT_CLOUDS
from service.export.rotation import rotation_of_angles

_WHAT: Final = "annotation of Datumaro"
_CUBOID: Final = "cuboid_3d"


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read the cuboids of a frame and label its points; a frame without an item has no labels.

    Raises:
        UsageError: If the file is none of Datumaro, has a frame that the scene does not have, or a
            class that is unknown.
    """
    path = _file_of(scene.place / "annotations")
    if path is None:
        return None
    read = read_json(path, what=_WHAT)
    try:
        names = [str(each["name"]) for each in read["categories"]["label"]["labels"]]
        items = {Path(str(each["id"])).name.removesuffix(".pcd"): each for each in read["items"]}
        known = {f"{each.number:06d}" for each in scene.frames}
        strange = next((each for each in items if each not in known), None)
        item = items.get(f"{frame.number:06d}")
        found = [] if item is None else _cuboids(item, names, scene)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise unlike(_WHAT, error, path) from None
    if strange is not None:
        raise of_another_scene(_WHAT, f"it has an item {strange!r}", path)
    if item is None:
        return None
    return labels_in_cuboids(points_of(scene.place / CVAT_CLOUDS, frame), found)


def _cuboids(item: dict[str, Any], names: list[str], scene: ExportedScene) -> list[Cuboid]:
    found = [each for each in item["annotations"] if each["type"] == _CUBOID]
    if len(found) > MAX_CUBOIDS:
        raise ValueError(f"{len(found)} cuboids in one frame")
    made: list[Cuboid] = []
    for place, each in enumerate(found):
        label, attributes = int(each["label_id"]), each.get("attributes", {})
        if not 0 <= label < len(names):
            raise ValueError(f"unknown class {label}")
        name = f"{item['id']}/{place}" if "track_id" not in attributes else attributes["track_id"]
        made.append(
            cuboid(
                centre_m=each["position"],
                rotation=rotation_of_angles(each["rotation"], order="xyz"),
                size_m=each["scale"],
                class_name=names[label],
                moving=attributes.get(MOVING_ATTRIBUTE),
                number=number_of(str(name), scene.numbers),
            )
        )
    return made


def _file_of(folder: Path) -> Path | None:
    """Return the file of a folder: Datumaro names it by its subset."""
    found = sorted(folder.glob("*.json"))
    if len(found) > 1:
        raise UsageError(f"cannot read labels: {len(found)} files of annotations ({folder})")
    return found[0] if found else None


CVAT_LABELS: Final = LabelForm(
    name="cvat",
    finished="annotations/*.json of each scene",
    exports=("cvat",),
    read_frame=read_frame,
)
"""Export CVAT's 3D task as `Datumaro 3D 1.0`."""
