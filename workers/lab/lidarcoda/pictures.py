"""Pictures of LidarCODA: one per annotation to grade it by, and the pies of the evaluation."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from workers.lab.lidarcoda.annotations import Annotation, Image
from workers.lab.lidarcoda.cameras import Camera
from workers.lab.lidarcoda.clustering import ClusteredBox
from workers.lab.lidarcoda.evaluation import Evaluation
from workers.lab.lidarcoda.measures import Averaging, PointSet, paper_measures
from workers.lab.plots import load_pyplot, save_figure
from workers.lidar.fidelity import Form

_OBJECT: Final = "#d55e00"
_REST: Final = "#0072b2"
_OUTCOMES: Final = (
    *(("hit", "#009e73"), ("false alarm", "#e69f00")),
    *(("missed", "#d55e00"), ("neither", "#bbbbbb")),
)


def draw_annotation(
    path: Path,
    *,
    image_file: Path,
    image: Image,
    annotation: Annotation,
    box: ClusteredBox,
    camera: Camera,
) -> None:
    """Draw a box with the choices of DBSCAN and of mean shift, on the picture and from above."""
    pyplot = load_pyplot()
    figure, panels = pyplot.subplots(2, 2, figsize=(11, 7), constrained_layout=True)
    choices: Mapping[str, Any] = {"DBSCAN": box.dbscan, "mean shift": box.mean_shift}
    xyz = box.columns[:, :3].astype(np.float64)
    pixels = camera(xyz)
    left, top, width, height = annotation.box_px
    for place, (name, chosen) in enumerate(choices.items()):
        upper, lower = panels[0][place], panels[1][place]
        if image_file.is_file():
            upper.imshow(pyplot.imread(image_file))
        upper.add_patch(
            pyplot.Rectangle((left, top), width, height, fill=False, edgecolor="black", lw=1.5)
        )
        colours = np.where(chosen > 0, _OBJECT, _REST)
        upper.scatter(*pixels.pixels.T, c=colours[pixels.index], s=9)
        margin = max(width, height) * 0.5
        upper.set_xlim(left - margin, left + width + margin)
        upper.set_ylim(top + height + margin, top - margin)
        upper.set_title(f"{name}: {int((chosen > 0).sum())} of {len(chosen)} points")
        lower.scatter(xyz[:, 0], xyz[:, 1], c=colours, s=9)
        lower.set_aspect("equal", adjustable="datalim")
        lower.set_xlabel("x, m")
        lower.set_ylabel("y, m")
    figure.suptitle(
        f"annotation {annotation.id}: {annotation.category} in {image.file_name} "
        "(orange: chosen as the object)"
    )
    save_figure(figure, path)


def draw_pies(folder: Path, found: Evaluation, *, form: Form) -> tuple[Path, ...]:
    """Draw the mean confusion of all frames and of all annotations, for each set of points."""
    pyplot = load_pyplot()
    paths = []
    for name, counts, sets in (
        ("frames", found.frame_counts, tuple(PointSet)),
        ("annotations", found.annotation_counts, (PointSet.BOXES, PointSet.OVERLAP)),
    ):
        figure, axes = pyplot.subplots(
            1, len(sets), figsize=(3.6 * len(sets), 3.8), constrained_layout=True
        )
        for axis, points in zip(axes, sets, strict=True):
            measures = paper_measures(
                counts, points, clustered=True, averaging=Averaging.INDIVIDUAL, form=form
            )
            shares = [max(0.0, share) for share in measures.ratios]
            if sum(shares):
                axis.pie(shares, colors=[colour for _, colour in _OUTCOMES], startangle=90)
            axis.set_title(f"{points}, n = {measures.n}")
        figure.legend(
            handles=[pyplot.Line2D([], [], marker="o", ls="", color=c) for _, c in _OUTCOMES],
            labels=[text for text, _ in _OUTCOMES],
            loc="outside lower center",
            ncols=4,
            frameon=False,
        )
        path = folder / f"{name}.png"
        save_figure(figure, path)
        paths.append(path)
    return tuple(paths)
