"""What is made of contradicting points: labelled frames, instances, tracks."""

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

BESIDE_S: Final = 1.0
"""Frames this near before and after a scene, or a track, say what it was: what starts, at a metre
per second squared, is half a metre on by then, and still in its place."""


class ContradictionKind(StrEnum):
    """The kinds of the task `MOTION`, as records name them: who alone says that something moves.

    It does not say who errs.
    """

    ONLY_SEMANTIC_DYNAMIC = "only_semantic_dynamic"
    ONLY_PREDICTIVE_DYNAMIC = "only_predictive_dynamic"
    ONLY_WITNESS_DYNAMIC = "only_witness_dynamic"


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """A posed frame with both streams' answers and their agreement, point by point.

    Attributes:
        posed: The frame and its pose.
        semantic: Labels of the supervised stream.
        predictive: Labels of the self-supervised stream.
        agreements: (N,) codes of the task's outcomes.
        task: What both were asked.
        witness: What the third witness says; None where none was asked.
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
        """Nanoseconds since the Unix epoch, of the frame."""
        return self.posed.frame.stamp_ns


class SceneState(StrEnum):
    """What may be made of a scene's score."""

    SCORED = "scored"
    TOO_SHORT = "too_short"
    ODOMETRY_LOST = "odometry_lost"


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Consecutive labelled frames of one log: the unit that is scored, ranked and selected.

    Attributes:
        scene_id: `<log_id>/<lidar>/<start_ns>`, unique in the bucket.
        frames: In the order of their stamps; at least one.
        too_short: A piece under a second between gaps, or a log too short to judge.
        before: Up to a second of the log right before it, where no gap lies between:
            what a thing at its edge was, never scored with it.
        after: And right after it.
    """

    scene_id: str
    frames: tuple[LabelledFrame, ...]
    too_short: bool = False
    before: tuple[LabelledFrame, ...] = ()
    after: tuple[LabelledFrame, ...] = ()

    @property
    def task(self) -> Task:
        """What both streams were asked about its points."""
        return self.frames[0].task

    @property
    def start_ns(self) -> int:
        """First frame, nanoseconds since the Unix epoch."""
        return self.frames[0].stamp_ns

    @property
    def end_ns(self) -> int:
        """Last frame, nanoseconds since the Unix epoch."""
        return self.frames[-1].stamp_ns


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """A cluster of contradicting points of one kind in one frame, large enough to keep.

    Attributes:
        kind: How the two streams contradict each other about its points.
        frame_index: Which frame of the scene it was found in.
        point_index: (M,) the points that make it up.
        centre_m: (3,) centre of its box, sensor space, metres.
        size_m: (3,) length (>= width), width, height of its box, metres.
        yaw_rad: Heading of the length axis about z, sensor space, in [-pi/2, pi/2).
        semantic_confidence: Mean of the supervised stream over its points, 0 to 1.
        predictive_confidence: Mean of the self-supervised stream over its points, 0 to 1.
        class_name: Commonest semantic class of its points; empty when the stream knows none.
        velocity_m_per_s: (3,) mean velocity over the ground, odom space; zero when not measured.
        own_share: Share of the compared points in and close around it that contradict in the same
            way: 1 for a thing on its own, little for the rim of an agreed mover or for specks on a
            wall.
        confirmed_share: Share of its points of which the self-supervised stream proved more than
            once that they move; None where that stream says static, or does not tell.
        denied_share: Of all that the one who says dynamic calls so in and around its box, a metre
            each way: share that the other stream calls static.
        agreed_share: And dynamic; about the rest it is silent.
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


KindName = Annotated[
    str,
    Field(
        max_length=MAX_NAME,
        pattern=r"^[a-z0-9_]+$",
        description="How the streams contradict each other: for motion, which alone says that it "
        "moves, `only_semantic_dynamic` or `only_predictive_dynamic`.",
    ),
]


class InstanceRecord(BaseModel):
    """An instance as it travels: its box, size and what both sides thought."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stamp_ns: StampNs = Field(description="Frame it was found in, nanoseconds since the epoch.")
    points: Positive = Field(description="Contradicting points in it.")
    centre_m: tuple[Finite, Finite, Finite] = Field(description="Box centre, sensor space, metres.")
    size_m: tuple[Finite, Finite, Finite] = Field(description="Length, width, height, metres.")
    yaw_rad: Finite = Field(description="Heading of the length axis about z, sensor space.")
    range_m: Finite = Field(ge=0, description="Horizontal distance from the sensor, metres.")
    semantic_confidence: float = Field(ge=0, le=1, description="Mean over its points.")
    predictive_confidence: float = Field(ge=0, le=1, description="Mean over its points.")


class TrackRecord(BaseModel):
    """One contradicting thing followed over the frames of a scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    track_id: Tally = Field(description="Counts within the scene, strongest first.")
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
        description="Share of its points that the self-supervised stream proved to move more than "
        "once; absent where that stream says static or does not tell.",
    )
    attribution: Attribution | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Who is probably wrong about it; absent from records of earlier services.",
    )
    strongest: InstanceRecord = Field(description="Its instance with the most evidence.")
