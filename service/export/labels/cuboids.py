"""Labels from cuboids: the exported points in each have its class, and the motion that it states.

Points in two cuboids belong to the smaller one. A point in none has no label.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.export.classes import MOVING_ATTRIBUTE, moving_class, semantickitti_ids
from service.export.labels.finished import DYNAMIC, FIRST_MOVING, STATIC, UNKNOWN, FinishedLabels

UNNAMED: Final = frozenset({"", "object", "unlabeled", "unknown", "other"})
"""Types of objects that no class names."""

MAX_CUBOIDS: Final = 10_000
"""Cuboids of one frame at most."""

MAX_SIZE_M: Final = 1_000.0
"""Edge of a cuboid at most, metres."""

FACE_M: Final = 0.01
"""Distance outside a face up to which a point is inside, metres: exported boxes are tight, and they
and the points of an overlay are rounded to centimetres."""

MAX_OBJECT: Final = 0xFFFF
"""Largest number of an object: the upper 16 bits of a word."""

_YES: Final = frozenset({"true", "yes", "moving", "dynamic"})
_NO: Final = frozenset({"false", "no", "static", "stationary"})


@dataclass(frozen=True, slots=True, eq=False)
class Cuboid:
    """One finished cuboid, in the sensor space of its frame.

    Attributes:
        centre_m: (3,) metres.
        rotation: (3, 3) its axes in the sensor space, as columns.
        size_m: (3,) along its axes, metres.
        word: Class of SemanticKITTI at rest or in motion, and the object in the upper 16 bits.
        motion: 0 unknown, 1 static, 2 dynamic.
    """

    centre_m: NDArray[np.float64]
    rotation: NDArray[np.float64]
    size_m: NDArray[np.float64]
    word: int
    motion: int


def number_of(name: str, numbers: dict[str, int]) -> int:
    """Return the number of an object of a scene, 1 first; `numbers` grows by new names."""
    return numbers.setdefault(name, min(len(numbers) + 1, MAX_OBJECT))


def cuboid(
    *,
    centre_m: Sequence[float],
    rotation: NDArray[np.float64],
    size_m: Sequence[float],
    class_name: str,
    moving: Any,
    number: int,
    class_names: Sequence[str] = (),
) -> Cuboid:
    """Check a cuboid of a file.

    Args:
        centre_m: Its centre, metres.
        rotation: (3, 3) its axes as columns.
        size_m: Its edges, metres.
        class_name: Its class, by a name of SemanticKITTI or of the streams' coarse classes.
        moving: What its attribute states; None: nothing.
        number: Its object.
        class_names: Further names that are known, though SemanticKITTI has no class for them.

    Raises:
        ValueError: If a number is none, or a name is unknown.
    """
    centre, size = np.array(centre_m, dtype=np.float64), np.array(size_m, dtype=np.float64)
    if centre.shape != (3,) or size.shape != (3,) or rotation.shape != (3, 3):
        raise ValueError("a cuboid needs three numbers for its centre and three for its size")
    numbers = np.concatenate([centre, size, rotation.reshape(-1)])
    if not np.isfinite(numbers).all() or not ((size >= 0) & (size <= MAX_SIZE_M)).all():
        raise ValueError(f"a cuboid with edges of {size.tolist()} m at {centre.tolist()}")
    found, moves = _class_of(class_name, class_names), _moves(moving)
    if found >= FIRST_MOVING:
        moves = True
    elif moves:
        found = int(semantickitti_ids((class_name,))[1][0])
    motion = UNKNOWN if moves is None else DYNAMIC if moves else STATIC
    return Cuboid(centre, rotation, size, found | number << 16, motion)


def labels_in_cuboids(
    points_m: NDArray[np.floating[Any]], cuboids: Sequence[Cuboid], *, digest: str = ""
) -> FinishedLabels:
    """Label the points of a frame.

    Args:
        points_m: (N, 3) exported points in the sensor space, metres.
        cuboids: Its cuboids.
        digest: Digest of what the file states about this frame.
    """
    words = np.zeros(len(points_m), dtype=np.uint32)
    motion = np.full(len(points_m), UNKNOWN, dtype=np.uint8)
    for each in sorted(cuboids, key=lambda each: -float(np.prod(each.size_m))):
        inside = points_in(points_m, each)
        words[inside], motion[inside] = each.word, each.motion
    return FinishedLabels(words, motion, digest)


def points_in(points_m: NDArray[np.floating[Any]], box: Cuboid) -> NDArray[np.int64]:
    """Return the places of the points in a cuboid, those near its faces included."""
    half_m = box.size_m / 2 + FACE_M
    reach = float(np.linalg.norm(half_m))
    near = np.flatnonzero((np.abs(points_m - box.centre_m) <= reach).all(axis=1))
    own = (points_m[near] - box.centre_m) @ box.rotation
    inside: NDArray[np.int64] = near[(np.abs(own) <= half_m).all(axis=1)]
    return inside


def xyz_of(about: Mapping[str, Any]) -> list[float]:
    """Return the numbers x, y and z of an object."""
    return [float(about[axis]) for axis in "xyz"]


def _class_of(name: str, class_names: Sequence[str]) -> int:
    moving = moving_class(name)
    found = moving or int(semantickitti_ids((name,))[0][0])
    if not found and name.strip().lower() not in UNNAMED and name not in class_names:
        raise ValueError(f"unknown class {name!r}")
    return found


def _moves(told: Any) -> bool | None:
    if told is None or isinstance(told, bool):
        return told
    text = str(told).strip().lower()
    if text in _YES:
        return True
    if text in _NO:
        return False
    if text in ("", "unknown"):
        return None
    raise ValueError(f"attribute {MOVING_ATTRIBUTE!r} is {told!r}, and needs true or false")
