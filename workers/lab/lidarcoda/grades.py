"""Manual grades: a person's answer, per annotation, which of the two clusterings is right."""

import json
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.errors import PermanentError
from workers.lab.lidarcoda.clustering import ClusteredBox

GRADES_FILE: Final = "grades.json"
"""Grades by annotation id, in the folder of the build."""


class Grade(IntEnum):
    """The nine grades of the paper's notebooks."""

    DBSCAN_RIGHT = 1
    MEAN_SHIFT_RIGHT = 2
    BOTH_RIGHT = 3
    UNION_RIGHT = 4
    DBSCAN_CHOSE_THE_REST = 5
    CLUSTERS_WRONG = 6
    ANNOTATION_WRONG = 7
    MEAN_SHIFT_CHOSE_THE_REST = 8
    CLUSTERS_TOO_FINE = 9


def object_labels(box: ClusteredBox, grade: int) -> NDArray[np.int8]:
    """Label the points of a box by its grade: +1 of the object, -1 not.

    Grades 6, 7 and 9 label the whole box, 5 and 8 invert a choice. An unknown grade labels the
    whole box too, which the published steps do with a typing error; `read_grades` refuses it in the
    corrected form.

    Returns:
        (N,) labels in the order of the box's points.
    """
    if grade in (Grade.DBSCAN_RIGHT, Grade.BOTH_RIGHT):
        return box.dbscan
    if grade == Grade.MEAN_SHIFT_RIGHT:
        return box.mean_shift
    if grade == Grade.UNION_RIGHT:
        return np.maximum(box.dbscan, box.mean_shift)
    if grade == Grade.DBSCAN_CHOSE_THE_REST:
        return np.negative(box.dbscan)
    if grade == Grade.MEAN_SHIFT_CHOSE_THE_REST:
        return np.negative(box.mean_shift)
    return np.ones(len(box.index), np.int8)


def read_grades(folder: Path) -> dict[int, int]:
    """Read the grades of a build; empty before the first grade.

    Raises:
        PermanentError: If the file is damaged.
    """
    path = folder / GRADES_FILE
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text())
        return {int(annotation): int(grade) for annotation, grade in found.items()}
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise PermanentError(f"cannot read the grades: {error} ({path})") from None


def write_grades(folder: Path, grades: Mapping[int, int]) -> None:
    """Write all grades of a build, whole or not at all."""
    path = folder / GRADES_FILE
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps({str(key): grades[key] for key in sorted(grades)}, indent=0))
    temporary.replace(path)


def read_published_grades(path: Path, *, published: bool = False) -> dict[int, int]:
    """Read a file of the published form, whose line i is the grade of annotation i.

    Args:
        path: The file.
        published: True to accept grades that do not exist, as the published steps do.

    Raises:
        PermanentError: If a line is no grade from 1 to 9; the message names the line.
    """
    try:
        lines = path.read_text().split()
    except (OSError, UnicodeDecodeError) as error:
        raise PermanentError(f"cannot read the grades: {error}") from None
    grades: dict[int, int] = {}
    for number, line in enumerate(lines, start=1):
        grades[number] = checked_grade(line, place=f"{path}, line {number}", published=published)
    return grades


def checked_grade(text: str, *, place: str, published: bool = False) -> int:
    """Convert the text of a grade.

    Raises:
        PermanentError: If it is no grade; `place` is in the message.
    """
    known = {str(int(grade)) for grade in Grade}
    if text in known or (published and text.isdecimal()):
        return int(text)
    raise PermanentError(f"{text[:20]!r} is no grade from 1 to 9 ({place})")
