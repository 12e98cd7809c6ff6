"""What is kept of a mined log: its scenes, contradicting tracks and things."""

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Attribution, Wrong

REVISION: Final = "4"
"""Rises when the same log gives other rows."""

_STRICT = ConfigDict(frozen=True, extra="forbid")

OTHER_KIND: Final = "other"
"""A failure that nobody planted: a side effect, or the network's own."""


class ThingRow(BaseModel):
    """A thing of a scene that the supervised stream can be right or wrong about."""

    model_config = _STRICT

    key: str = Field(description="Its name in the scene.")
    track: int = Field(description="Of the truth; -1 none.")
    class_name: str = Field(description="What truth calls it; may be empty.")
    moves: bool = Field(description="Whether it truly moves.")
    frames: int = Field(description="In which it has 25 points.")
    points: int = Field(description="Median over these frames.")
    fails: bool = Field(description="Whether the supervised stream fails on it.")
    kind: str = Field(default="", description="Kind of the failure as planted; empty: no failure.")
    common_mode: bool = Field(default=False, description="Planted as a common-mode failure.")
    other_wrong_share: float = Field(
        description="Of the self-supervised stream: share of its points that are wrong, in the "
        "failing frames, or in all where it does not fail."
    )
    views: dict[str, float] = Field(
        default_factory=dict, description="What other ways to rank say of it; higher is worse."
    )


class TrackRow(BaseModel):
    """A contradicting track of a scene."""

    model_config = _STRICT

    kind: str = Field(description="Who alone says that it moves.")
    strength: float = Field(description="As recorded.")
    presence: float = Field(
        description="Strength without gate and blame: how lasting and large it is."
    )
    gate: float = Field(description="What doubted poses leave of it; 0 in a scene not scored.")
    frames: int
    points: int = Field(description="Over all frames.")
    thing: str = Field(description="Key of the thing that it lies on; empty: none.")
    true_track: int = Field(description="True object that it lies on; -1 none.")
    verdict: Wrong | None = Field(description="Who is wrong, by truth; null: truth is silent.")
    said: Attribution | None = Field(
        default=None, description="Who is said to be wrong; null: that is not said."
    )
    evidence: dict[str, float] = Field(description="What is known about it, by name.")


class SceneRow(BaseModel):
    """A scored scene."""

    model_config = _STRICT

    scene_id: str
    start_ns: int
    cell: int = Field(description="Which scene of its log, from 0.")
    state: str
    score: float
    seconds: float
    blind_share: float = Field(description="Frames of which the self-supervised stream was blind.")
    views: dict[str, float]
    things: tuple[ThingRow, ...]
    tracks: tuple[TrackRow, ...]
    disturbance: str = Field(default="", description="Its kind; empty: none.")
    hard: bool = False

    @property
    def fails(self) -> bool:
        """Whether it holds a failure."""
        return any(thing.fails for thing in self.things)

    @property
    def failing(self) -> tuple[ThingRow, ...]:
        """Its failures."""
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
    pipeline_version: str
