"""Records of a mined log: scenes, contradicting tracks and objects of interest."""

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Attribution, Wrong
from workers.lab.simulation.faults.fault_truth import FailureRow

REVISION: Final = "5"
"""Version of the rows; increases when the same log gives other rows."""

_STRICT = ConfigDict(frozen=True, extra="forbid")

OTHER_KIND: Final = "other"
"""Kind of a failure that was not planted: a side effect, or the network's own."""


class ObjectRow(BaseModel):
    """An object of interest of a scene, on which the supervised stream is evaluated."""

    model_config = _STRICT

    key: str = Field(description="Its name in the scene.")
    track: int = Field(description="True track number; -1 none.")
    class_name: str = Field(description="True class; may be empty.")
    moves: bool = Field(description="Whether it truly moves.")
    frames: int = Field(description="Frames in which it has 25 points.")
    points: int = Field(description="Median number over these frames.")
    fails: bool = Field(description="Whether the supervised stream fails on it.")
    kind: str = Field(default="", description="Kind of the failure as planted; empty: no failure.")
    common_mode: bool = Field(default=False, description="Planted as a common-mode failure.")
    other_wrong_share: float = Field(
        description="Of the self-supervised stream: share of its points that are wrong, in the "
        "failing frames, or in all where it does not fail."
    )
    views: dict[str, float] = Field(
        default_factory=dict, description="Baseline scores by name; higher is worse."
    )


class TrackRow(BaseModel):
    """A contradicting track of a scene."""

    model_config = _STRICT

    kind: str = Field(description="Which stream alone labels it moving.")
    strength: float = Field(description="As recorded.")
    presence: float = Field(
        description="Strength without gate and attribution: its duration and size."
    )
    gate: float = Field(description="Factor of doubtful poses; 0 in a scene not scored.")
    frames: int
    points: int = Field(description="Over all frames.")
    thing: str = Field(description="Key of the object below it; empty: none.")
    true_track: int = Field(description="Track number of that object in truth; -1 none.")
    verdict: Wrong | None = Field(description="True verdict; null: truth unknown.")
    said: Attribution | None = Field(default=None, description="Recorded attribution; null: none.")
    evidence: dict[str, float] = Field(description="Its evidence, by name.")
    first_frame: int = Field(default=-1, description="Frame of the scene in which it begins.")
    place_m: tuple[float, float, float] | None = Field(
        default=None, description="Centre of its middle box, odom space, metres."
    )
    size_m: tuple[float, float, float] | None = Field(
        default=None, description="Length, width and height of that box, metres."
    )
    class_name: str = Field(default="", description="Its semantic class, as recorded.")
    strongest_m: tuple[float, float, float] | None = Field(
        default=None, description="Centre of its strongest instance, sensor space, metres."
    )
    speed_m_per_s: float | None = Field(
        default=None, description="As recorded; null: rows of earlier revisions."
    )


class SceneRow(BaseModel):
    """A scored scene."""

    model_config = _STRICT

    scene_id: str
    start_ns: int
    cell: int = Field(description="Number of the scene in its log, from 0.")
    state: str
    score: float
    seconds: float
    blind_share: float = Field(description="Share of frames without self-supervised labels.")
    views: dict[str, float]
    things: tuple[ObjectRow, ...] = Field(description="Objects of interest of the scene.")
    tracks: tuple[TrackRow, ...]
    disturbance: str = Field(default="", description="Its kind; empty: none.")
    hard: bool = False

    @property
    def fails(self) -> bool:
        """True if the scene contains a failure."""
        return any(thing.fails for thing in self.things)

    @property
    def failing(self) -> tuple[ObjectRow, ...]:
        """Failing objects of the scene."""
        return tuple(thing for thing in self.things if thing.fails)


class MinedLog(BaseModel):
    """A log, mined and compared with its truth."""

    model_config = _STRICT

    log_id: str
    frames: int
    scenes: tuple[SceneRow, ...]
    planted: int = Field(default=0, description="Failures that were planted in it.")
    unseen: int = Field(
        default=0, description="Of them, those that the labels do not show: too few points left."
    )
    failures: tuple[FailureRow, ...] = Field(
        default=(), description="The planted failures, where the benchmark planted them."
    )
    shown: tuple[int, ...] = Field(
        default=(), description="Of `failures`, the numbers of those that the labels show."
    )
    pipeline_version: str
