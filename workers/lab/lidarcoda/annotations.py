"""CODA's annotations: images and 2D boxes of corner cases, read from `corner_case.json`."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from schemas.errors import PermanentError

ANNOTATIONS_FILE: Final = "corner_case.json"


class Dataset(StrEnum):
    """Data set that an image of CODA comes from; the start of its file name states it."""

    KITTI = "kitti"
    NUSCENES = "nuscenes"
    ONCE = "once"


class _Category(BaseModel):
    model_config = ConfigDict(extra="ignore")
    id: int
    name: str
    supercategory: str


class _Image(BaseModel):
    model_config = ConfigDict(extra="ignore")
    id: int = Field(ge=0)
    file_name: str


class _Annotation(BaseModel):
    model_config = ConfigDict(extra="ignore")
    id: int = Field(ge=0)
    image_id: int
    category_id: int
    bbox: tuple[float, float, float, float]


class _File(BaseModel):
    model_config = ConfigDict(extra="ignore")
    images: list[_Image]
    annotations: list[_Annotation]
    categories: list[_Category]


@dataclass(frozen=True, slots=True)
class Annotation:
    """A 2D box around one corner case.

    Attributes:
        id: Number of the annotation in CODA.
        image_id: Number of its image.
        category: Class of the object, such as `traffic_cone`.
        supercategory: One of the seven groups of classes.
        box_px: x and y of the upper left corner, width and height, pixels.
    """

    id: int
    image_id: int
    category: str
    supercategory: str
    box_px: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Image:
    """A camera picture of CODA; its lidar frame has the same id."""

    id: int
    file_name: str
    dataset: Dataset

    @property
    def stem(self) -> str:
        """Four-digit id, which names every file that is written for the image."""
        return f"{self.id:04d}"


@dataclass(frozen=True, slots=True)
class Coda:
    """All images by id, and the annotations of each in the order of their ids."""

    images: Mapping[int, Image]
    annotations: tuple[Annotation, ...]

    def of_image(self, image_id: int) -> tuple[Annotation, ...]:
        """Return the annotations of one image, by id."""
        return tuple(each for each in self.annotations if each.image_id == image_id)


def read_coda(folder: Path) -> Coda:
    """Read the annotations of a folder in CODA's form.

    Raises:
        PermanentError: If the file is missing, is not of CODA's form, lists an id twice, or an
            annotation names an image or a category that the file does not contain.
    """
    path = folder / ANNOTATIONS_FILE
    try:
        found = _File.model_validate_json(path.read_bytes())
    except OSError as error:
        raise PermanentError(f"cannot read CODA's annotations: {error.strerror} ({path})") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise PermanentError(f"no annotations of CODA: {place}: {first['msg']} ({path})") from None
    _need_unique("image", [each.id for each in found.images], path)
    _need_unique("annotation", [each.id for each in found.annotations], path)
    categories = {each.id: each for each in found.categories}
    images = {each.id: Image(each.id, each.file_name, _dataset(each)) for each in found.images}
    annotations = []
    for each in sorted(found.annotations, key=lambda one: one.id):
        category = categories.get(each.category_id)
        if category is None or each.image_id not in images:
            what = "category" if category is None else "image"
            number = each.category_id if category is None else each.image_id
            raise PermanentError(f"annotation {each.id} names {what} {number}, absent from {path}")
        annotations.append(
            Annotation(each.id, each.image_id, category.name, category.supercategory, each.bbox)
        )
    return Coda(dict(sorted(images.items())), tuple(annotations))


def _dataset(image: _Image) -> Dataset:
    name = Path(image.file_name).name
    for dataset in (Dataset.KITTI, Dataset.NUSCENES):
        if name.startswith(f"{dataset}_"):
            return dataset
    return Dataset.ONCE


def _need_unique(what: str, ids: list[int], path: Path) -> None:
    if len(set(ids)) != len(ids):
        twice = next(number for number in ids if ids.count(number) > 1)
        raise PermanentError(f"{what} {twice} is listed twice in {path}")
