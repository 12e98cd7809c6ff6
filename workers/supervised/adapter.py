"""Adapter of a user's own model: a TOML file that describes inputs and outputs of its networks.

It is in the folder of the exported networks that it names; `deploy/OWN_MODEL.md` explains each
entry.
"""

import tomllib
from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import MAX_TEXT_BYTES, read_regular
from workers.lidar.range_image import CHANNELS, Channel, SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.residual_image import ResidualSettings

MAX_CHANNELS: Final = 16
"""Largest number of input channels; there are five measurements."""

MAX_SCORES: Final = 1 << 26
"""Largest number of scores of one image: 254 classes on the largest lidars, 128 x 2048, are 256 MiB
of float32."""

_STRICT: Final = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class NetworkEntry(BaseModel):
    """One exported network."""

    model_config = _STRICT

    file: str = Field(
        min_length=1, max_length=1024, description="Beside the adapter: .onnx, .pt or .pt2."
    )
    input: Literal["range-image", "points"] = Field(
        default="range-image",
        description="What it is given: (1, C, H, W), normalised, or (1, N, C) of the valid points "
        "in metres.",
    )
    channels: tuple[Channel, ...] = Field(
        default=CHANNELS,
        min_length=1,
        max_length=MAX_CHANNELS,
        description="What it sees, in this order.",
    )
    output: str = Field(
        default="", max_length=256, description="Name of the output, where there are several."
    )
    answer: Literal["logits", "probabilities", "labels"] = Field(
        default="logits",
        description="What it gives: (1, K, H, W) scores or (1, H, W) class numbers; of points "
        "(1, N, K) or (1, N).",
    )
    classes: tuple[ClassMeaning, ...] = Field(
        min_length=1, max_length=254, description="In the order of outputs."
    )
    residual: ResidualSettings | None = Field(
        default=None, description="Past frames whose residual images follow the channels."
    )

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if all(meaning.ignored for meaning in self.classes):
            raise ValueError("every class is ignored")
        if not any(meaning.movable or meaning.moving for meaning in self.classes):
            raise ValueError("no class is movable or moving: nothing could ever contradict")
        if self.residual is not None and self.input == "points":
            raise ValueError("residual images belong to range images, not to points")
        return self


class Adapter(BaseModel):
    """A user's own model: its networks, classes and range image."""

    model_config = _STRICT

    name: str = Field(
        pattern=r"^[A-Za-z0-9._-]+$", max_length=64, description="What the stream's version says."
    )
    profile: SensorProfile | None = Field(
        default=None, description="Layout and normalisation of the range image."
    )
    semantic: NetworkEntry | None = Field(default=None, description="Says what each point is.")
    motion: NetworkEntry | None = Field(default=None, description="Says what moves.")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        entries = [entry for entry in (self.semantic, self.motion) if entry is not None]
        if not entries:
            raise ValueError("name a network under [semantic], [motion] or both")
        if len({entry.input for entry in entries}) > 1:
            raise ValueError("both networks take range images, or both take points")
        if entries[0].input == "range-image" and self.profile is None:
            raise ValueError("networks over range images need a [profile]")
        if self.image is not None:
            pixels = self.image.rows * self.image.columns
            scores = max(len(entry.classes) for entry in entries) * pixels
            if scores > MAX_SCORES:
                raise ValueError(
                    f"an image has at most {MAX_SCORES:,} scores, rows times columns times "
                    f"classes; these are {scores:,}"
                )
        return self

    @property
    def image(self) -> SensorProfile | None:
        """Layout of the range image that the networks take; None if they take points."""
        entry = self.semantic or self.motion
        return self.profile if entry is not None and entry.input == "range-image" else None

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read an adapter.

        Raises:
            WeightsUnusableError: If it cannot be read or is contradictory; the message names file
                and entry.
        """
        try:
            said = _toml(path, what="the adapter of your own model")
            if isinstance(said.get("profile"), str):
                path = path.parent / said["profile"]
                said |= {"profile": _toml(path, what="the adapter's profile")["profile"]}
            return cls.model_validate(said)
        except KeyError:
            raise WeightsUnusableError(
                f"profile: a file that `counterpoint calibrate sensor` wrote is needed ({path})"
            ) from None
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the adapter"
            what = first["msg"].removeprefix("Value error, ")
            raise WeightsUnusableError(f"{where}: {what} ({path})") from error


def _toml(path: Path, *, what: str) -> dict[str, Any]:
    text = read_regular(path, what=what, most=MAX_TEXT_BYTES)
    try:
        return tomllib.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, deep nesting
        raise WeightsUnusableError(f"{what} is no TOML: {error} ({path})") from error
