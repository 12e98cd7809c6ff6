"""Training images on disk: one folder per sensor, memory-mapped, shared by training processes."""

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import PermanentError
from workers.lab.datasets.images import TrainingImages

_ARRAYS = tuple(field.name for field in fields(TrainingImages))


class ImagesUnusableError(PermanentError):
    """A folder does not contain training images."""


def join(parts: Sequence[TrainingImages]) -> TrainingImages:
    """Concatenate images of one layout."""
    return TrainingImages(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
    )


def write_images(folder: Path, images: TrainingImages, *, source: dict[str, str | int]) -> None:
    """Write each array as a file.

    Args:
        folder: Folder to create.
        images: Images to write; the measurements are stored in half precision.
        source: How they were made; goes into the model card.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in _ARRAYS:
        array = getattr(images, name)
        _save(folder / f"{name}.npy", array.astype(np.float16) if name == "channels" else array)
    (folder / "source.json").write_text(json.dumps(source, indent=1) + "\n")


class _Writer:
    """A file without a descriptor: numpy then writes it by `write`, whose errors have an errno.

    `np.save` into a file with a descriptor is `ndarray.tofile`, which on a full disk raises an
    OSError that says neither errno nor file.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def write(self, content: bytes, /) -> int:
        """Write bytes, all of them or with an error."""
        return self._file.write(content)


def _save(path: Path, array: NDArray[Any]) -> None:
    with path.open("wb") as file:
        np.save(_Writer(file), array, allow_pickle=False)


def read_images(folder: Path) -> tuple[TrainingImages, dict[str, str | int]]:
    """Open the images of one sensor; arrays are memory-mapped and read on access.

    Returns:
        The images, and how they were made.

    Raises:
        ImagesUnusableError: If a file is missing.
    """
    try:
        arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in _ARRAYS}
        source = json.loads((folder / "source.json").read_text())
    except FileNotFoundError as error:
        raise ImagesUnusableError(
            f"no training images: begin the training again with --restart ({error.filename})"
        ) from error
    return TrainingImages(**arrays), source
