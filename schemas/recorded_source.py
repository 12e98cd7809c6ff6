"""Sources of a model's answer without a channel: constant transforms, files next to a log."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_INTEGER, Finite, Said, Url

_STRICT = ConfigDict(frozen=True, extra="forbid")


class StatedPose(BaseModel):
    """Constant pose of one space of a log in another."""

    model_config = _STRICT

    parent: Said
    child: Said
    parent_from_child: tuple[Finite, ...] = Field(
        min_length=16, max_length=16, description="4 x 4 matrix, row by row, metres."
    )


class PredictionFiles(BaseModel):
    """Files with the model's answer, in the folder of the setting `predictions`."""

    model_config = _STRICT

    kind: Literal["labels", "boxes"] = Field(description="A file per cloud, or one of boxes.")
    key: Url = Field(description="Prefix of the files of clouds, or key of the file of boxes.")
    by_stamp: bool = Field(default=False, description="Files of clouds are named by their stamps.")
    first_cloud: int = Field(
        default=-1,
        ge=-1,
        le=MAX_INTEGER,
        description="Number of the shard's first cloud; -1: none.",
    )
