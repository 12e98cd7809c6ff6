"""Labels of `fiftyone`: the 3D detections of `samples.json`, with their points.

FiftyOne writes no labels of points. A sample is found by its fields `scene_id` and `frame`, since
FiftyOne may rename the files. The attribute `moving` of a detection states if its object moves.
"""

from typing import Any, Final

from service.export.classes import MOVING_ATTRIBUTE
from service.export.fiftyone_dataset import SAMPLES, digest_of_detections
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
from service.export.rotation import rotation_of_angles

_WHAT: Final = "list of samples of FiftyOne"


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read the detections of a frame and label its points; a frame without a sample has no labels.

    Raises:
        UsageError: If the samples are none of FiftyOne, if none is of the scene, or if a class is
            unknown.
    """
    path = scene.place.parent.parent / SAMPLES
    read = read_json(path, what=_WHAT)
    try:
        mine = [each for each in read["samples"] if each.get("scene_id") == scene.scene_id]
        samples = [each for each in mine if each["frame"] == frame.number]
        detections = [each for sample in samples for each in sample["contradictions"]["detections"]]
        if len(samples) > 1 or len(detections) > MAX_CUBOIDS:
            raise ValueError(f"{len(samples)} samples with {len(detections)} detections")
        found = [_cuboid(each, scene) for each in detections]
        digest = digest_of_detections(detections)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise unlike(_WHAT, error, path, frame=frame.number) from None
    if not mine:
        raise of_another_scene(_WHAT, f"it has no sample of {scene.scene_id!r}", path)
    if not samples:
        return None
    return labels_in_cuboids(points_of(scene.place, frame), found, digest=digest)


def _cuboid(detection: dict[str, Any], scene: ExportedScene) -> Cuboid:
    index = detection.get("index")
    name = detection.get("_id") if index is None else index
    return cuboid(
        centre_m=detection["location"],
        rotation=rotation_of_angles(detection["rotation"], order="xyz"),
        size_m=detection["dimensions"],
        class_name=str(detection["label"]),
        moving=detection.get(MOVING_ATTRIBUTE),
        number=number_of(str(name), scene.numbers),
    )


FIFTYONE_LABELS: Final = LabelForm(
    name="fiftyone", finished="samples.json", exports=("fiftyone",), read_frame=read_frame
)
"""`samples.json`, replaced by the one that FiftyOne exports."""
