"""Mining settings that all workers share: grid of shards, reading of logs, and parts."""

import re
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from schemas.bounds import MAX_SCENES_OF_A_SHARD, Blob, Finite, Name, Url

LOOKAHEAD: Final = ":lookahead-"
"""Separator in the name of a stream; the seconds it waits for later frames follow it."""

MAX_JOINED: Final = 8
"""Lidars that are joined into one scene; vehicles carry up to six."""

_STRICT = ConfigDict(frozen=True, extra="forbid")


class Grid(BaseModel):
    """Grid of a log: shards are whole multiples of the scene length on one grid per log."""

    model_config = _STRICT

    scene_s: float = Field(default=2.0, gt=0, le=60, description="Length of a scene.")
    shard_s: float = Field(default=20.0, gt=0, le=3600, description="Length of a shard's window.")
    warmup_s: float = Field(
        default=1.2, ge=0, le=10, description="Warm-up before a window, for parts with a state."
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
    """Settings that every worker of a service must share; the reply to `hello`.

    They never contain credentials: each process takes its own from its environment.
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
        description="Your own model: the adapter's TOML file. Every worker reads it from this "
        "path; the pipeline version depends on its content, not on the path.",
    )
    weights: Url = Field(
        default="",
        description="Folder of imported weights, for every chosen network; empty: the included "
        "ones. Every worker reads it from this path.",
    )
    device: Literal["auto", "cpu", "cuda"] = Field(
        default="auto",
        description="Device of the networks SalsaNext and LMNet, in mining and training; auto: a "
        "GPU of CUDA where there is one. A GPU is part of the pipeline version, because its sums "
        "differ: where only some machines have one, cpu makes all agree.",
    )
    selfsupervised: Name = Field(
        default="registration",
        description="Self-supervised stream, one that `counterpoint parts` lists.",
    )
    motion_rule: Blob = Field(
        default="",
        description="Thresholds of the two-stage rule: a JSON file that `calibrate motion` wrote, "
        "for the streams `two-stage…`; empty: the published ones.",
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
    lidar_topic: Url = Field(
        default="",
        description="Lidar topic to mine; several of one vehicle, separated by commas, are joined "
        "in the space of the first one; empty: detected, each lidar mined for itself.",
    )
    recorded_topic: Url = Field(
        default="",
        description="Topic with the answer of the car's model, points or boxes, for the stream "
        "`recorded`; empty: detected.",
    )
    predictions: Url = Field(
        default="",
        description="Folder or bucket with the model's answer next to the logs, for the stream "
        "`recorded`: `.label` files or Parquet of boxes; empty: the logs contain it. Each answer "
        "of a model needs a folder of its own: the pipeline version depends on this URL.",
    )
    odometry_topic: Url = Field(
        default="",
        description="Topic of the recorded motion of the car, compared with the odometry in logs "
        "that have it; empty: detected; none: not used.",
    )
    place_topic: Url = Field(
        default="",
        description="Topic of the car's place on Earth, which records then state: NavSatFix, "
        "LocationFix, or odometry in metres of a frame that the whole fleet shares; empty: the "
        "first NavSatFix or LocationFix; none: records state no place.",
    )
    camera: Blob = Field(
        default="",
        description="Camera calibration for streams that compare only a camera's view: "
        "`recorded` takes that of the log's front camera, a JSON file gives one for "
        "all logs; empty: none.",
    )
    path_template: Url = Field(
        default="{vehicle}/{date}/{name}",
        description="Pattern of vehicle and date in a key, matched from the right, for logs "
        "without these.",
    )
    stamp_at: Literal["start", "middle", "end"] = Field(
        default="start", description="Instant of the revolution that a header stamp gives."
    )
    compensated: Literal["auto", "yes", "no"] = Field(
        default="auto",
        description="Clouds with a time per point were recorded without the motion of the car, all "
        "in the sensor's space of one instant; auto: recognised while the car moves.",
    )
    pictures: Literal["all", "small", "none"] = Field(
        default="small",
        description="Camera pictures kept with a scene, faces and plates on them included; small: "
        "at most eight, 640 pixels wide, of the frames in which its reported tracks are strongest; "
        "all: as recorded, of every camera and frame that sees a reported track; none: no picture. "
        "A change applies to scenes mined from then on.",
    )
    intensity_scale: Finite = Field(
        default=0.0, ge=0, description="Recorded value that means 1; 0: detected."
    )

    @model_validator(mode="after")
    def _predictions_are_read(self) -> "MiningSettings":
        if self.predictions and not self.takes_recorded:
            raise ValueError(
                "predictions: only the supervised stream `recorded` reads them; set supervised to "
                f"recorded, not {self.supervised}"
            )
        return self

    @model_validator(mode="after")
    def _motion_rule_is_read(self) -> "MiningSettings":
        if self.motion_rule and self.selfsupervised.partition(":")[0] != "two-stage":
            raise ValueError(
                "motion_rule: only the self-supervised streams `two-stage` read it; set "
                f"selfsupervised to two-stage, not {self.selfsupervised}"
            )
        return self

    @model_validator(mode="after")
    def _lidars_can_be_joined(self) -> "MiningSettings":
        names = self.lidar_names
        if ("" in names and self.lidar_topic) or len(names) > MAX_JOINED:
            raise ValueError(
                f"lidar_topic: {self.lidar_topic!r} must be one topic, or 2 to {MAX_JOINED} topics "
                "separated by commas"
            )
        if len(set(names)) < len(names):
            raise ValueError(f"lidar_topic: {self.lidar_topic!r} names a topic twice")
        return self

    @property
    def lidar_names(self) -> tuple[str, ...]:
        """Topics of the setting `lidar_topic`, the main lidar first; one empty text: detected."""
        return tuple(name.strip() for name in self.lidar_topic.split(","))

    @property
    def takes_recorded(self) -> bool:
        """True if the supervised stream, for any task, reads the labels recorded in the log."""
        return self.supervised.partition(":")[0] == "recorded"

    @property
    def ahead_ns(self) -> int:
        """Time by which later frames may influence a frame's labels, nanoseconds."""
        _, found, lookahead_s = self.selfsupervised.partition(LOOKAHEAD)
        return round(float(lookahead_s) * 1e9) if found else 0

    @field_validator("selfsupervised")
    @classmethod
    def _lookahead_is_a_time(cls, name: str) -> str:
        _, found, lookahead_s = name.partition(LOOKAHEAD)
        if found and not re.fullmatch(r"[0-9](\.[0-9])?", lookahead_s):
            raise ValueError(f"{name!r} must end in seconds, such as {LOOKAHEAD}0.5")
        return name
