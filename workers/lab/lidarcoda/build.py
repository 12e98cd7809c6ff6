"""Build of LidarCODA: clusters the points of every box, then labels the images that are graded.

A build that was interrupted goes on where it stopped, and gives the same bytes.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from schemas.errors import PermanentError
from workers.lab.lidarcoda.annotations import Coda, Image
from workers.lab.lidarcoda.cameras import read_camera
from workers.lab.lidarcoda.clustering import cluster_box
from workers.lab.lidarcoda.files import has_box, read_box, read_cloud, write_box
from workers.lab.lidarcoda.grades import read_grades
from workers.lab.lidarcoda.labels import write_labels

MANIFEST: Final = "manifest.json"
VERSION: Final = 1
"""Version of the layout of a build."""


@dataclass(frozen=True, slots=True)
class Built:
    """Outcome of a build.

    Attributes:
        images: Images with annotations.
        annotations: Annotations of these images.
        clustered: Annotations that this run clustered; the others were there before.
        points: Points in all boxes.
        empty: Annotations without a lidar point.
        ungraded: Annotations without a grade.
        labelled_images: Images whose labels are written.
    """

    images: int
    annotations: int
    clustered: int
    points: int
    empty: int
    ungraded: int
    labelled_images: int


def build(
    source: Path,
    out: Path,
    coda: Coda,
    *,
    published: bool = False,
    on_progress: Callable[[int], None] = lambda done: None,
) -> Built:
    """Cluster every annotation, and label every image whose annotations all have a grade.

    Args:
        source: Folder in CODA's form, with `lidar/NNNN.bin` and `calib/NNNN` for each image.
        out: Folder of the build.
        coda: The annotations of `source`.
        published: True for the published form of projection and labels.
        on_progress: Called with the number of finished annotations.

    Raises:
        PermanentError: If a file of an image is missing or damaged, or the folder contains a build
            of the other form.
    """
    _need_same_form(out, published=published)
    grades = read_grades(out)
    images = [image for image in coda.images.values() if coda.of_image(image.id)]
    done = clustered = points = empty = labelled = 0
    for image in images:
        annotations = coda.of_image(image.id)
        clustered += _cluster_image(source, out, image, coda, published=published)
        boxes = {each.id: read_box(out, each.id) for each in annotations}
        points += sum(len(box.index) for box in boxes.values())
        empty += sum(len(box.index) == 0 for box in boxes.values())
        if all(each.id in grades for each in annotations):
            write_labels(out, image, boxes, grades, published=published)
            labelled += 1
        done += len(annotations)
        on_progress(done)
    ungraded = sum(each.id not in grades for each in coda.annotations)
    built = Built(len(images), done, clustered, points, empty, ungraded, labelled)
    counts = {key: value for key, value in asdict(built).items() if key != "clustered"}
    _write_manifest(out, {"version": VERSION, "published": published, **counts})
    return built


def _cluster_image(source: Path, out: Path, image: Image, coda: Coda, *, published: bool) -> int:
    missing = [each for each in coda.of_image(image.id) if not has_box(out, each.id)]
    if missing:
        seen = read_camera(source, image, published=published)(read_cloud(source, image))
        for each in missing:
            write_box(out, each.id, cluster_box(seen, each.box_px))
    return len(missing)


def _need_same_form(out: Path, *, published: bool) -> None:
    path = out / MANIFEST
    if not path.exists():
        _write_manifest(out, {"version": VERSION, "published": published})
        return
    try:
        found = json.loads(path.read_text())
        same = (found["version"], found["published"]) == (VERSION, published)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PermanentError(f"cannot read the manifest of the build: {error} ({path})") from None
    if not same:
        raise PermanentError(f"{out} contains a build of another form or version; name another")


def _write_manifest(out: Path, content: dict[str, int | bool]) -> None:
    path = out / MANIFEST
    out.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(content, indent=1) + "\n")
    temporary.replace(path)
