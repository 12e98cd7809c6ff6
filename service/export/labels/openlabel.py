"""Labels of `openlabel`: the cuboids of the finished document of each scene.

The export has no points. The cuboids label those of the scene's overlay, whose places are those of
the raw message, at its resolution of a centimetre.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.errors import PermanentError
from schemas.overlay import NO_POSITION_CM, Overlay
from service.errors import UsageError
from service.export.classes import MOVING_ATTRIBUTE
from service.export.frames_file import digest_of_json
from service.export.labels.cuboids import (
    MAX_CUBOIDS,
    Cuboid,
    cuboid,
    labels_in_cuboids,
    number_of,
)
from service.export.labels.exported import ExportedFrame, ExportedLidar, ExportedScene, OpenCurrent
from service.export.labels.finished import FinishedLabels
from service.export.labels.form import LabelForm
from service.export.labels.label_file import of_another_scene, read_json, unlike
from service.export.openlabel import LIDAR, objects_of_frames, type_of
from service.export.points import PointLabels
from service.export.rotation import rotation_of_angles, rotation_of_quaternion

_WHAT: Final = "document of OpenLABEL"

_SAME_STAMP_S: Final = 1e-3
"""Difference up to which stamps are equal, seconds: programs keep them as numbers of 64 bits."""

_UNLIKE: Final = (KeyError, TypeError, ValueError, AttributeError, IndexError)


def open_scene(path: Path, scene_id: str, current: OpenCurrent) -> ExportedScene:
    """Find the points of a scene in its overlay.

    Raises:
        UsageError: If the scene is no longer current.
    """
    try:
        score, overlay = current(scene_id)
    except PermanentError as error:
        raise UsageError(
            f"cannot find the points of the cuboids: {error}: name the state or service that "
            f"the selection was exported from ({path})"
        ) from None
    tracks = {track.track_id: track for track in score.tracks}
    frames: list[ExportedFrame] = []
    for number, objects in enumerate(objects_of_frames(overlay, PointLabels(overlay, score))):
        types = {name: type_of(tracks.get(int(name))) for name in objects}
        index, points = _returns(overlay, number), overlay.points_of(number)
        lidars, first = [], int(overlay.main_points[number])
        lidars.append(ExportedLidar(score.lidar_topic, int(overlay.stamps_ns[number]), 0))
        for each in overlay.lidars:
            lidars.append(ExportedLidar(each.topic, int(each.stamps_ns[number]), first))
            first += int(each.points[number])
        frames.append(
            ExportedFrame(
                number=number,
                points=len(index),
                raw_points=points.stop - points.start,
                read_index=lambda index=index: index,  # type: ignore[misc]
                lidars=tuple(lidars),
                pre_labels=_digest(objects, types),
            )
        )
    return ExportedScene(path, scene_id, score.log_id, tuple(frames), overlay)


def read_frame(scene: ExportedScene, frame: ExportedFrame) -> FinishedLabels | None:
    """Read the cuboids of a frame and label its points; a frame that is not listed has no labels.

    Raises:
        UsageError: If the document is none of OpenLABEL, is of another scene, or has a class or a
            space that is unknown.
    """
    path, overlay = scene.place, scene.overlay
    if overlay is None:
        raise ValueError("a scene of OpenLABEL is opened with its overlay")
    read = read_json(path, what=_WHAT)
    try:
        document = read["openlabel"]
        frames, described = document.get("frames", {}), document.get("objects", {})
        strange = sorted({*frames} - {str(each.number) for each in scene.frames})
        about = frames.get(str(frame.number))
        why = "" if about is None else _otherness(document, about, scene, frame)
        objects = {} if about is None else about.get("objects", {})
        types = {name: str(described[name]["type"]) for name in objects}
        digest = _digest(objects, types)
        found = [] if why or strange else _cuboids(objects, described, scene, overlay)
    except _UNLIKE as error:
        raise unlike(_WHAT, error, path, frame=frame.number) from None
    if strange:
        raise of_another_scene(_WHAT, f"it has a frame {strange[0]!r}", path)
    if why:
        raise of_another_scene(_WHAT, why, path)
    if about is None:
        return None
    points_cm = overlay.points_cm[overlay.points_of(frame.number)][frame.index]
    return labels_in_cuboids(points_cm / 100.0, found, digest=digest)


def _otherness(
    document: dict[str, Any], about: dict[str, Any], scene: ExportedScene, frame: ExportedFrame
) -> str:
    """Return why a frame is one of another scene; empty: it is not.

    A frame is identified by its stamp; one without a stamp by the name of the document.
    """
    stamp_s = _seconds(about.get("frame_properties", {}).get("timestamp"))
    if stamp_s is not None:
        expected_s = frame.stamp_ns / NS_PER_S
        if not abs(stamp_s - expected_s) <= _SAME_STAMP_S:
            return f"frame {frame.number} has the stamp {stamp_s}, and the scene {expected_s:.9f}"
        return ""
    name = document.get("metadata", {}).get("name")
    return "" if name == scene.scene_id else f"its name is {name!r}, not {scene.scene_id!r}"


def _seconds(stamp: Any) -> float | None:
    """Return a stamp in seconds; None where there is none, or one of another clock."""
    try:
        return float(stamp)
    except (TypeError, ValueError):
        return None


def _cuboids(
    objects: dict[str, Any], described: dict[str, Any], scene: ExportedScene, overlay: Overlay
) -> list[Cuboid]:
    made: list[Cuboid] = []
    for name, about in objects.items():
        data, whole = about.get("object_data", {}), described[name]
        for each in data.get("cuboid", []):
            space = each.get("coordinate_system") or whole.get("coordinate_system") or LIDAR
            if space != LIDAR:
                raise ValueError(f"a cuboid in the space {space!r}: labels need {LIDAR!r}")
            told = (each.get("attributes", {}), data, whole.get("object_data", {}))
            values = [float(value) for value in each["val"]]
            made.append(
                cuboid(
                    centre_m=values[:3],
                    rotation=_rotation(values[3:-3]),
                    size_m=values[-3:],
                    class_name=str(whole["type"]),
                    moving=_first([_moving(level) for level in told]),
                    number=number_of(name, scene.numbers),
                    class_names=overlay.class_names,
                )
            )
    if len(made) > MAX_CUBOIDS:
        raise ValueError(f"{len(made)} cuboids in one frame")
    return made


def _rotation(turned: list[float]) -> NDArray[np.float64]:
    """Return the rotation of a quaternion, or of three angles."""
    if len(turned) == 3:
        return rotation_of_angles(turned, order="zyx")
    return rotation_of_quaternion(turned)


def _moving(level: dict[str, Any]) -> Any:
    """Return the attribute of a cuboid or of an object, as a truth value or as text."""
    attributes = [*level.get("boolean", []), *level.get("text", [])]
    return _first([each["val"] for each in attributes if each["name"] == MOVING_ATTRIBUTE])


def _first(found: list[Any]) -> Any:
    return next((each for each in found if each is not None), None)


def _returns(overlay: Overlay, number: int) -> NDArray[np.int64]:
    """Return the places of a frame's points that have a position in the overlay."""
    points_cm = overlay.points_cm[overlay.points_of(number)]
    index: NDArray[np.int64] = np.flatnonzero((points_cm != NO_POSITION_CM).any(axis=1))
    return index


def _digest(objects: dict[str, Any], types: dict[str, str]) -> str:
    """Digest the cuboids of a frame with the types of their objects."""
    return digest_of_json([objects, types])


OPENLABEL_LABELS: Final = LabelForm(
    name="openlabel",
    finished="the document of each scene",
    exports=("openlabel",),
    read_frame=read_frame,
    open_scene=open_scene,
)
"""The document of each scene, replaced by the finished one."""
