"""Labels as tools return them: a seeded rule changes those of an exported scene in its own files.

Each function returns what it labelled, for each frame by the place of the exported point. The
cuboids are placed and tested with SciPy's rotations, not with ours.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.exported_points import points_of

Words = NDArray[np.uint32]
Generator = np.random.Generator

CLASSES: Final = (*(0, 1, 10, 11, 13, 15, 16, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 52, 60),)
MOVING: Final = (252, 253, 254, 255, 256, 257, 258, 259)
NUSCENES: Final = {0: 0, 2: 30, 14: 11, 17: 10, 23: 18, 24: 40, 26: 48, 27: 72, 28: 50, 30: 70}
"""Classes of SemanticKITTI for bytes of nuScenes-lidarseg."""
NUSCENES_STATIC: Final = (24, 26, 27, 28, 30)
NAMED: Final = {"car": (10, 252), "person": (30, 254), "truck": (18, 258), "building": (50, 259)}
"""Class at rest and in motion by the names of cuboids."""
CUBOIDS: Final = 6
FACE_M: Final = 0.01
"""Distance outside a face up to which a point belongs to a cuboid."""
PART: Final = 0.3
"""Share of the points whose labels a rule changes."""


@dataclass(frozen=True, eq=False)
class Labelled:
    """Finished labels of one frame.

    Attributes:
        classes: (M,) classes of SemanticKITTI, in the order of the exported points.
        objects: (M,) numbers of objects; None: of any number, but the same for equal `named`.
        motion: (M,) 0 unknown, 1 static, 2 dynamic.
        named: (M,) the cuboid of each point, -1 none.
    """

    classes: NDArray[np.int64]
    motion: NDArray[np.int64]
    objects: NDArray[np.int64] | None = None
    named: NDArray[np.int64] | None = None


def label_semantickitti(place: Path, random: Generator) -> list[Labelled]:
    found = []
    for path in sorted((place / "labels").iterdir()):
        words = _changed(np.fromfile(path, dtype="<u4"), random)
        words.astype("<u4").tofile(path)
        found.append(_of_words(words))
    return found


def label_segments(place: Path, random: Generator) -> list[Labelled]:
    label = json.loads((place / "label.json").read_text())
    found = []
    for frame in label["frames"]:
        of = {a["id"]: a["category_id"] | a["track_id"] << 16 for a in frame["annotations"]}
        before = np.array([of.get(each, 0) for each in frame["point_annotations"]], dtype="u4")
        words = _changed(before, random)
        kinds, numbers = np.unique(words, return_inverse=True)
        frame["annotations"] = [
            {"id": number, "category_id": word & 0xFFFF, "track_id": word >> 16}
            for number, word in enumerate(kinds.tolist(), start=1)
        ]
        frame["point_annotations"] = (numbers + 1).tolist()
        found.append(_of_words(words))
    (place / "label.json").write_text(json.dumps(label))
    return found


def label_nuscenes(place: Path, random: Generator) -> list[Labelled]:
    (folder,) = (place / "lidarseg").iterdir()
    tables = place / folder.name
    rows = json.loads((tables / "sample_data.json").read_text())
    found = []
    for row in sorted(rows, key=lambda row: row["timestamp"]):
        path = folder / f"{row['token']}_lidarseg.bin"
        before = np.fromfile(path, dtype="u1")
        known = random.choice([*NUSCENES], len(before)).astype("u1")
        classes = np.where(random.random(len(before)) < PART, known, 28).astype("u1")
        classes.tofile(path)
        ids = np.array([NUSCENES[each] for each in classes.tolist()])
        motion = np.isin(classes, NUSCENES_STATIC).astype(int)
        found.append(Labelled(ids, motion, np.zeros(len(ids), dtype=int)))
    return found


def label_pcd(place: Path, random: Generator) -> list[Labelled]:
    """Write clouds again with labels: points in another order, and every second cloud as text."""
    from pypcd4.pypcd4 import Encoding, PointCloud

    found = []
    for number, path in enumerate(sorted(place.rglob("*.pcd"))):
        cloud = PointCloud.from_path(path)
        before = cloud.numpy(("label",))[:, 0].astype(np.uint32)
        words = _changed(before, random) & np.uint32(0xFFFF)
        points = cloud.pc_data.copy()
        points["label"] = words
        order = random.permutation(len(points))
        shuffled = PointCloud(cloud.metadata, points[order])
        shuffled.save(path, encoding=Encoding.ASCII if number % 2 else Encoding.BINARY)
        found.append(_of_words(words))
    return found


def label_xtreme1(place: Path, random: Generator) -> list[Labelled]:
    (place / "result").mkdir()
    found = []
    for number, (_, points) in enumerate(points_of("xtreme1", place)):
        boxes = _boxes(points, random)
        objects = [
            {
                "id": f"{number}-{box.name}",
                "type": "3D_BOX",
                "className": box.class_name,
                "trackId": f"track-{box.number}",
                "classValues": _xtreme1_values(box.moving),
                "contour": {
                    "center3D": dict(zip("xyz", box.centre.tolist(), strict=True)),
                    "rotation3D": dict(zip("xyz", box.angles.tolist(), strict=True)),
                    "size3D": dict(zip("xyz", box.size.tolist(), strict=True)),
                },
            }
            for box in boxes
        ]
        result = [{"version": "Xtreme1 V0.6", "sourceName": "Ground Truth", "objects": objects}]
        (place / "result" / f"{number:06d}.json").write_text(json.dumps(result))
        found.append(_in_boxes(points, boxes, "XYZ"))
    return found


def _xtreme1_values(moving: bool | None) -> list[dict[str, Any]]:
    if moving is None:
        return []
    return [{"name": "moving", "type": "RADIO", "value": str(moving).lower(), "isLeaf": True}]


def label_cvat(place: Path, random: Generator) -> list[Labelled]:
    names, items, found = [*NAMED], [], []
    for number, (_, points) in enumerate(points_of("cvat", place)):
        boxes = _boxes(points, random)
        annotations = [
            {
                "id": box.number,
                "type": "cuboid_3d",
                "attributes": {"occluded": False, "track_id": box.number}
                | ({} if box.moving is None else {"moving": box.moving}),
                "group": 0,
                "label_id": names.index(box.class_name),
                "position": box.centre.tolist(),
                "rotation": box.angles.tolist(),
                "scale": box.size.tolist(),
            }
            for box in boxes
        ]
        items.append({"id": f"pointcloud/{number:06d}", "annotations": annotations})
        found.append(_in_boxes(points, boxes, "XYZ"))
    labels = [{"name": name, "parent": "", "attributes": ["moving"]} for name in names]
    whole = {"info": {}, "categories": {"label": {"labels": labels}}, "items": items}
    (place / "annotations").mkdir()
    (place / "annotations" / "default.json").write_text(json.dumps(whole))
    return found


def label_fiftyone(place: Path, random: Generator) -> list[Labelled]:
    path = place.parent.parent / "samples.json"
    whole, found = json.loads(path.read_text()), []
    scene_id = json.loads((place / "frames.json").read_text())["scene_id"]
    for number, (_, points) in enumerate(points_of("fiftyone", place)):
        boxes = _boxes(points, random)
        (sample,) = [
            each
            for each in whole["samples"]
            if (each["scene_id"], each["frame"]) == (scene_id, number)
        ]
        sample["contradictions"]["detections"] = [
            {
                "_cls": "Detection",
                "label": box.class_name,
                "location": box.centre.tolist(),
                "dimensions": box.size.tolist(),
                "rotation": box.angles.tolist(),
                "index": box.number,
            }
            | ({} if box.moving is None else {"moving": box.moving})
            for box in boxes
        ]
        found.append(_in_boxes(points, boxes, "XYZ"))
    path.write_text(json.dumps(whole))
    return found


def label_openlabel(
    path: Path, random: Generator, points_of_frames: Sequence[NDArray[np.float64]]
) -> list[Labelled]:
    """Replace the cuboids of a document; its points are those of the overlay."""
    whole, found = json.loads(path.read_text()), []
    document = whole["openlabel"]
    document["objects"] = {
        str(number): {"name": f"o-{number}", "type": name} for number, name in enumerate(NAMED)
    }
    for number, points in enumerate(points_of_frames):
        boxes = _boxes(points, random)
        objects: dict[str, Any] = {}
        for box in boxes:
            if number % 2:
                turned = Rotation.from_euler("ZYX", box.angles[::-1]).as_quat().tolist()
            else:
                turned = box.angles.tolist()
            cuboid: dict[str, Any] = {
                "name": box.name,
                "val": [*box.centre.tolist(), *turned, *box.size.tolist()],
            }
            if box.moving is not None:
                cuboid["attributes"] = {"boolean": [{"name": "moving", "val": box.moving}]}
            key = str([*NAMED].index(box.class_name))
            known = objects.setdefault(key, {"object_data": {"cuboid": []}})
            known["object_data"]["cuboid"].append(cuboid)
        document["frames"][str(number)]["objects"] = objects
        of_class = [[*NAMED].index(box.class_name) for box in boxes]
        found.append(_in_boxes(points, boxes, "ZYX", numbers=of_class))
    path.write_text(json.dumps(whole))
    return found


LABELLERS: Final[Mapping[str, tuple[str, Callable[[Path, Generator], list[Labelled]]]]] = {
    "semantickitti": ("semantickitti", label_semantickitti),
    "segments": ("segments", label_segments),
    "nuscenes-lidarseg": ("nuscenes-lidarseg", label_nuscenes),
    "cvat": ("cvat", label_cvat),
    "pcd": ("cvat", label_pcd),
    "xtreme1": ("xtreme1", label_xtreme1),
    "fiftyone": ("fiftyone", label_fiftyone),
}
"""By form of the labels: the format of the export, and what labels it."""


@dataclass(frozen=True, eq=False)
class Box:
    """A cuboid that a person might place around some points."""

    number: int
    class_name: str
    centre: NDArray[np.float64]
    angles: NDArray[np.float64]
    size: NDArray[np.float64]
    moving: bool | None

    @property
    def name(self) -> str:
        return f"box-{self.number}"


def _boxes(points: NDArray[np.float64], random: Generator) -> list[Box]:
    return [
        Box(
            number=number,
            class_name=[*NAMED][number % len(NAMED)],
            centre=points[random.integers(len(points))] + random.normal(0, 0.3, 3),
            angles=random.normal(0, [0.7, 0.7, 2.0]),
            size=random.uniform(1.5, 6, 3),
            moving=[True, False, None][number % 3],
        )
        for number in range(CUBOIDS)
    ]


def _in_boxes(
    points: NDArray[np.float64],
    boxes: Sequence[Box],
    order: str,
    *,
    numbers: Sequence[int] | None = None,
) -> Labelled:
    """Return the labels of points; the smallest box of a point decides."""
    classes, motion = np.zeros(len(points), dtype=int), np.zeros(len(points), dtype=int)
    named, smallest = np.full(len(points), -1), np.full(len(points), np.inf)
    for place, box in enumerate(boxes):
        angles = box.angles if order == "XYZ" else box.angles[::-1]
        own = Rotation.from_euler(order, angles).inv().apply(points - box.centre)
        volume = float(np.prod(box.size))
        inside = (2 * np.abs(own) <= box.size + 2 * FACE_M).all(axis=1) & (volume < smallest)
        smallest[inside] = volume
        classes[inside] = NAMED[box.class_name][1 if box.moving else 0]
        motion[inside] = 0 if box.moving is None else 1 + box.moving
        named[inside] = box.number if numbers is None else numbers[place]
    return Labelled(classes, motion, named=named)


def _changed(words: Words, random: Generator) -> Words:
    """Change class and object of a part of the points."""
    changed = random.random(len(words)) < PART
    classes = random.choice([*CLASSES, *MOVING], len(words)).astype(np.uint32)
    objects = random.integers(0, 300, len(words)).astype(np.uint32)
    return np.where(changed, classes | objects << 16, words).astype(np.uint32)


def _of_words(words: NDArray[np.unsignedinteger]) -> Labelled:
    classes = (words & 0xFFFF).astype(np.int64)
    motion = np.where(classes >= 252, 2, np.where(classes <= 1, 0, 1))
    return Labelled(classes, motion, (words >> 16).astype(np.int64))
