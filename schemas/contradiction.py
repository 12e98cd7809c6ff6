"""Types of contradictions: labelled frames, scenes, instances, and records of tracks."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import Agreements, check_array, freeze
from schemas.attribution import Attribution
from schemas.bounds import MAX_NAME, Finite, Positive, Said, StampNs, Tally
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from schemas.task import MOTION, Outcome, Task

CONTEXT_S: Final = 1.0
"""Temporal context before and after a scene or a track, seconds.

An object that starts at one metre per second squared moves by half a metre in this time, and still
overlaps its place.
"""


class ContradictionKind(StrEnum):
    """Kinds of the task `MOTION`, as records name them: the only source that labels dynamic.

    A kind does not name the source that is wrong.
    """

    ONLY_SEMANTIC_DYNAMIC = "only_semantic_dynamic"
    ONLY_PREDICTIVE_DYNAMIC = "only_predictive_dynamic"
    ONLY_WITNESS_DYNAMIC = "only_witness_dynamic"


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """A posed frame with both streams' labels and their agreement, per point.

    Attributes:
        posed: The frame and its pose.
        semantic: Labels of the supervised stream.
        predictive: Labels of the self-supervised stream.
        agreements: (N,) codes of the task's outcomes.
        task: The task of both streams.
        witness: Labels of the third witness; None where none was queried.
    """

    posed: PosedFrame
    semantic: FrameLabels
    predictive: FrameLabels
    agreements: Agreements
    task: Task = MOTION
    witness: FrameLabels | None = None

    def __post_init__(self) -> None:
        """Check that every point has one agreement."""
        n = len(self.posed.frame)
        check_array("agreements", self.agreements, shape=(n,), dtype=np.uint8)
        freeze(self.agreements)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the frame, nanoseconds since the Unix epoch."""
        return self.posed.frame.stamp_ns


class SceneState(StrEnum):
    """State of a scene's score: only a scored scene is ranked."""

    SCORED = "scored"
    TOO_SHORT = "too_short"
    ODOMETRY_LOST = "odometry_lost"


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Consecutive labelled frames of one log: the unit that is scored, ranked and selected.

    Attributes:
        scene_id: `<log_id>/<lidar>/<start_ns>`, unique in the bucket.
        frames: Its frames in the order of their stamps; at least one.
        too_short: True for a piece under a second between gaps, or of a log too short to judge.
        before: Frames of up to one second of the log right before it, up to a gap: the context of
            objects at its edge, which is never scored with it.
        after: Frames of up to one second right after it.
    """

    scene_id: str
    frames: tuple[LabelledFrame, ...]
    too_short: bool = False
    before: tuple[LabelledFrame, ...] = ()
    after: tuple[LabelledFrame, ...] = ()

    @property
    def task(self) -> Task:
        """Task of both streams."""
        return self.frames[0].task

    @property
    def start_ns(self) -> int:
        """Stamp of the first frame, nanoseconds since the Unix epoch."""
        return self.frames[0].stamp_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last frame, nanoseconds since the Unix epoch."""
        return self.frames[-1].stamp_ns


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """A cluster of contradicting points of one kind in one frame, large enough to keep.

    Attributes:
        kind: Kind of contradiction of its points.
        frame_index: Index of its frame in the scene.
        point_index: (M,) rows of its points in the frame.
        centre_m: (3,) centre of its box, sensor space, metres.
        size_m: (3,) length (>= width), width, height of its box, metres.
        yaw_rad: Heading of the length axis about z, sensor space, in [-pi/2, pi/2).
        semantic_confidence: Mean confidence of the supervised stream over its points, 0 to 1.
        predictive_confidence: Mean confidence of the self-supervised stream, 0 to 1.
        class_name: Commonest semantic class of its points; empty for a stream without classes.
        velocity_m_per_s: (3,) mean velocity over the ground, odom space; zero when not measured.
        own_share: Share of the compared points in and close around it that contradict in the same
            way: 1 for an isolated object, low for the rim of an agreed mover or for specks on a
            wall.
        confirmed_share: Share of its points whose motion the self-supervised stream confirmed more
            than once; None where that stream labels them static, or does not report it.
        denied_share: Share of the points around it labelled dynamic by its source that the other
            stream labels static. They are all in its box and a margin of one metre.
        agreed_share: Share of these points that the other stream labels dynamic too. It labels the
            rest unknown.
        rim_share: Share of its points next to a point that both label dynamic, within about 0.6 m.
    """

    kind: Outcome
    frame_index: int
    point_index: NDArray[np.int64]
    centre_m: NDArray[np.float64]
    size_m: NDArray[np.float64]
    yaw_rad: float
    semantic_confidence: float
    predictive_confidence: float
    class_name: str = ""
    velocity_m_per_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    own_share: float = 1.0
    confirmed_share: float | None = None
    denied_share: float = 1.0
    agreed_share: float = 0.0
    rim_share: float = 1.0


KindName = Annotated[
    str,
    Field(
        max_length=MAX_NAME,
        pattern=r"^[a-z0-9_]+$",
        description="Kind of contradiction: for motion the only source that labels it dynamic, "
        "such as `only_semantic_dynamic` or `only_predictive_dynamic`.",
    ),
]


class InstanceRecord(BaseModel):
    """Record of an instance: its box, its points and the confidences of both streams."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stamp_ns: StampNs = Field(description="Stamp of its frame, nanoseconds since the epoch.")
    points: Positive = Field(description="Contradicting points in it.")
    centre_m: tuple[Finite, Finite, Finite] = Field(description="Box centre, sensor space, metres.")
    size_m: tuple[Finite, Finite, Finite] = Field(description="Length, width, height, metres.")
    yaw_rad: Finite = Field(description="Heading of the length axis about z, sensor space.")
    range_m: Finite = Field(ge=0, description="Horizontal distance from the sensor, metres.")
    semantic_confidence: float = Field(ge=0, le=1, description="Mean over its points.")
    predictive_confidence: float = Field(ge=0, le=1, description="Mean over its points.")


class TrackRecord(BaseModel):
    """Record of a track: one contradicting object followed over the frames of a scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    track_id: Tally = Field(description="Number within the scene, strongest first.")
    kind: KindName
    class_name: Said = Field(default="", description="Commonest semantic class; may be empty.")
    strength: float = Field(ge=0, le=1, description="What this track adds to the scene score.")
    first_ns: StampNs = Field(description="First frame it was seen in.")
    last_ns: StampNs = Field(description="Last frame it was seen in.")
    frames: Positive = Field(description="Frames of the scene in which it contradicts.")
    points: Positive = Field(description="Contradicting points over all those frames.")
    speed_m_per_s: Finite = Field(ge=0, description="Median speed over the ground; 0 unmeasured.")
    confirmed_share: float | None = Field(
        default=None,
        ge=0,
        le=1,
        exclude_if=lambda value: value is None,
        description="Share of its points whose motion the self-supervised stream confirmed more "
        "than once; absent where that stream labels it static or does not report it.",
    )
    attribution: Attribution | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Attribution to the streams; absent from records of earlier services.",
    )
    strongest: InstanceRecord = Field(description="Its instance with the most evidence.")
