"""What every worker does alike: how logs are cut and read, and by which parts they are mined."""

import re
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from schemas.bounds import MAX_SCENES_OF_A_SHARD, Blob, Finite, Name, Url

LOOKAHEAD: Final = ":lookahead-"
"""In the name of a stream: the seconds that follow are how long it waits for later frames."""

_STRICT = ConfigDict(frozen=True, extra="forbid")


class Grid(BaseModel):
    """How logs are cut: shards are whole multiples of the scene length on one grid per log."""

    model_config = _STRICT

    scene_s: float = Field(default=2.0, gt=0, le=60, description="Length of a scene's cell.")
    shard_s: float = Field(default=20.0, gt=0, le=3600, description="Length of a shard's window.")
    warmup_s: float = Field(
        default=1.2, ge=0, le=10, description="Read before a window, for what has state."
    )

    @model_validator(mode="after")
    def _shards_hold_whole_scenes(self) -> "Grid":
        cells = self.shard_s / self.scene_s
        if cells > MAX_SCENES_OF_A_SHARD:
            raise ValueError(
                f"shard_s ({self.shard_s:g}) must be at most {MAX_SCENES_OF_A_SHARD} times "
                f"scene_s ({self.scene_s:g})"
            )
        if cells < 1 or abs(cells - round(cells)) > 1e-9:
            raise ValueError(
                f"shard_s ({self.shard_s:g}) must be a whole multiple of scene_s ({self.scene_s:g})"
            )
        return self


class MiningSettings(BaseModel):
    """What every worker of a service must do alike; answered to `hello`.

    Credentials are never part of it: each process takes its own from its environment.
    """

    model_config = _STRICT

    bucket: Url = Field(description="URL of the log bucket.")
    artifacts: Url = Field(description="URL of the folder or bucket for point-level overlays.")
    grid: Grid = Field(default_factory=Grid, description="Scene and shard lengths, warm-up.")
    supervised: Name = Field(
        default="salsanext-lmnet",
        description="Supervised stream, one that `counterpoint parts` lists.",
    )
    model: Url = Field(
        default="",
        description="Your own model: the adapter's TOML file. Every worker reads it there; what is "
        "in it counts, not where it lies.",
    )
    weights: Url = Field(
        default="",
        description="Folder of imported weights, for every network that is chosen; empty: what "
        "ships. Every worker reads it there.",
    )
    selfsupervised: Name = Field(
        default="registration",
        description="Self-supervised stream, one that `counterpoint parts` lists.",
    )
    odometry: Name = Field(
        default="kiss-icp", description="Odometry, one that `counterpoint parts` lists."
    )
    witness: Name = Field(
        default="free-space",
        description="Third witness, one that `counterpoint parts` lists.",
    )
    instances: Name = Field(
        default="default",
        description="Rule by which contradicting points become instances, one that "
        "`counterpoint parts` lists.",
    )
    lidar_topic: Url = Field(default="", description="Mine this topic only; empty: by evidence.")
    odometry_topic: Url = Field(
        default="",
        description="What the car recorded of its own motion, held against the odometry: this "
        "topic, in logs that have it; empty: by evidence; none: not looked for.",
    )
    camera: Blob = Field(
        default="",
        description="For streams that compare only what a camera sees: `recorded` takes the "
        "calibration of the log's front camera, a JSON file states one for all logs; empty: none.",
    )
    path_template: Url = Field(
        default="{vehicle}/{date}/{name}",
        description="Vehicle and date of a log, matched from the right of its key, where the log "
        "itself does not say.",
    )
    stamp_at: Literal["start", "middle", "end"] = Field(
        default="start", description="Which instant of the revolution a header stamp names."
    )
    intensity_scale: Finite = Field(
        default=0.0, ge=0, description="Recorded value that means 1; 0: by evidence."
    )

    @property
    def takes_recorded(self) -> bool:
        """Whether the supervised stream, for whatever task, is what the log itself says."""
        return self.supervised.partition(":")[0] == "recorded"

    @property
    def ahead_ns(self) -> int:
        """How much later than a frame those are that its labels may wait for."""
        _, found, lookahead_s = self.selfsupervised.partition(LOOKAHEAD)
        return round(float(lookahead_s) * 1e9) if found else 0

    @field_validator("selfsupervised")
    @classmethod
    def _lookahead_is_a_time(cls, name: str) -> str:
        _, found, lookahead_s = name.partition(LOOKAHEAD)
        if found and not re.fullmatch(r"[0-9](\.[0-9])?", lookahead_s):
            raise ValueError(f"{name!r} must end in seconds, such as {LOOKAHEAD}0.5")
        return name
