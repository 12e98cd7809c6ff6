"""Evaluation of a method on LidarCODA: both tables of the paper, in published or corrected form."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.errors import PermanentError
from workers.lab.lidarcoda.annotations import Coda, Dataset
from workers.lab.lidarcoda.files import read_floats
from workers.lab.lidarcoda.labels import KITTI_AXES, PER_ANNOTATION
from workers.lab.lidarcoda.matching import COLUMNS, match_points
from workers.lab.lidarcoda.measures import Averaging, Measures, PointSet, paper_measures
from workers.lab.lidarcoda.method_output import read_method
from workers.lidar.fidelity import Form

PAPER_FRAMES: Final = {
    "CODA": (8.9, 13.2, 26.2, 17.5),
    Dataset.ONCE: (8.9, 14.0, 27.1, 18.4),
    Dataset.KITTI: (10.9, 13.3, 29.0, 18.3),
    Dataset.NUSCENES: (0.4, 0.7, 1.0, 0.8),
}
"""Table 1 of the paper: mIoU, AP, AR, F1 in percent, by data set."""

PAPER_ANNOTATIONS: Final = {
    "pedestrian": (33.9, 44.1, 37.3, 40.4),
    "cyclist": (41.6, 58.3, 49.5, 53.5),
    "vehicle": (33.0, 48.3, 41.0, 44.4),
    "animal": (0.0, 0.0, 0.0, 0.0),
    "traffic_facility": (28.6, 39.9, 33.9, 36.7),
    "obstruction": (20.5, 34.0, 22.9, 27.4),
    "misc": (36.7, 60.7, 37.9, 46.7),
}
"""Table 2 of the paper: the same by supercategory."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a table.

    Attributes:
        name: Data set or supercategory.
        measures: Measures of the row.
        paper: mIoU, AP, AR and F1 of the paper, percent; None where it has no such row.
        outcomes: Points of the method in categories 1 to 4.
    """

    name: str
    measures: Measures
    paper: tuple[float, float, float, float] | None
    outcomes: tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Counts and tables of one run.

    Attributes:
        frames: Table 1: all points, clustered, individual.
        annotations: Table 2: overlap, clustered, individual.
        frame_counts: (F, 21) counts in the order of `COLUMNS`, a row for each image.
        image_ids: (F,) the image of each row.
        annotation_counts: (A, 21) counts, a row for each annotation.
        annotation_ids: (A,) the annotation of each row.
        without_output: Labelled images for which the method has no output.
        unlabelled: Images with annotations that are not graded.
    """

    frames: tuple[Row, ...]
    annotations: tuple[Row, ...]
    frame_counts: NDArray[np.int64]
    image_ids: NDArray[np.int64]
    annotation_counts: NDArray[np.int64]
    annotation_ids: NDArray[np.int64]
    without_output: int
    unlabelled: int


def evaluate(labels: Path, method: Path, coda: Coda, *, form: Form = Form.CORRECTED) -> Evaluation:
    """Compare a method's categories with the point labels of all labelled images.

    Args:
        labels: Folder of a build.
        method: Folder with the method's output (`read_method`).
        coda: The annotations.
        form: Corrected or published form of matching and measures.

    Raises:
        PermanentError: If no image has both labels and output, or a file is damaged.
    """
    frame_rows: list[tuple[int, NDArray[np.int64]]] = []
    annotation_rows: list[tuple[int, NDArray[np.int64]]] = []
    without_output = unlabelled = 0
    for image in coda.images.values():
        annotations = coda.of_image(image.id)
        path = labels / KITTI_AXES / f"{image.stem}.bin"
        if not annotations or not path.is_file():
            unlabelled += bool(annotations)
            continue
        found = read_method(method, image)
        if found is None:
            without_output += 1
            continue
        points, category = found
        matched = match_points(read_floats(path, 4), points, category, form=form)
        frame_rows.append((image.id, matched.counts()))
        for each in annotations:
            own = labels / f"{KITTI_AXES}{PER_ANNOTATION}" / f"{each.id}.bin"
            one = match_points(read_floats(own, 4), points, category, form=form)
            annotation_rows.append((each.id, one.annotation_counts()))
    if not frame_rows:
        raise PermanentError(
            f"no image has both point labels in {labels} and the method's output in {method}"
        )
    image_ids, frame_counts = _stacked(frame_rows)
    annotation_ids, annotation_counts = _stacked(annotation_rows)
    return Evaluation(
        _frame_table(frame_counts, image_ids, coda, form),
        _annotation_table(annotation_counts, annotation_ids, coda, form),
        *(frame_counts, image_ids, annotation_counts, annotation_ids),
        without_output,
        unlabelled,
    )


def _frame_table(
    counts: NDArray[np.int64], ids: NDArray[np.int64], coda: Coda, form: Form
) -> tuple[Row, ...]:
    datasets = np.array([coda.images[number].dataset for number in ids.tolist()])
    groups: list[tuple[str, NDArray[np.bool_]]] = [("CODA", np.ones(len(ids), np.bool_))]
    groups += [(each, datasets == each) for each in (Dataset.ONCE, Dataset.KITTI, Dataset.NUSCENES)]
    return _rows(groups, counts, PointSet.ALL, PAPER_FRAMES, form)


def _annotation_table(
    counts: NDArray[np.int64], ids: NDArray[np.int64], coda: Coda, form: Form
) -> tuple[Row, ...]:
    of = {each.id: each.supercategory for each in coda.annotations}
    names = np.array([of[number] for number in ids.tolist()])
    wanted = [*PAPER_ANNOTATIONS, *sorted(set(names.tolist()) - set(PAPER_ANNOTATIONS))]
    groups = [(name, names == name) for name in wanted]
    return _rows(groups, counts, PointSet.OVERLAP, PAPER_ANNOTATIONS, form)


def _rows(
    groups: Iterable[tuple[str, NDArray[np.bool_]]],
    counts: NDArray[np.int64],
    points: PointSet,
    paper: dict[str, tuple[float, float, float, float]],
    form: Form,
) -> tuple[Row, ...]:
    rows = []
    for name, chosen in groups:
        if not chosen.any():
            continue
        own = counts[chosen]
        measures = paper_measures(
            own, points, clustered=True, averaging=Averaging.INDIVIDUAL, form=form
        )
        outcomes = [int(own[:, _of_category(number)].sum()) for number in range(1, 5)]
        rows.append(
            Row(
                str(name),
                measures,
                paper.get(name),
                (outcomes[0], outcomes[1], outcomes[2], outcomes[3]),
            )
        )
    return tuple(rows)


def _of_category(number: int) -> list[int]:
    return [COLUMNS.index(name) for name in (f"c{number}", f"c1{number}", f"c-1{number}")]


def _stacked(
    rows: list[tuple[int, NDArray[np.int64]]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    ids = np.array([number for number, _ in rows], np.int64)
    return ids, np.stack([counts for _, counts in rows])
