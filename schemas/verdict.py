"""Verdicts of reviewers on scenes and tracks: stored, published and listed."""

from enum import StrEnum
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import NO_NUL, Count, Digest, Name, SceneId, Seconds, Tally

MAX_NOTE: Final = 2000
"""Characters of a reviewer's note."""

MAX_KEY: Final = 128
"""Characters of the key that a client gives a write."""

Note = Annotated[str, Field(max_length=MAX_NOTE, pattern=NO_NUL)]
Cause = Annotated[str, Field(max_length=64, pattern=NO_NUL)]
"""Name of a cause, of the taxonomy or of the setting `causes`; empty: none is given."""

WriteKey = Annotated[str, Field(min_length=1, max_length=MAX_KEY, pattern=NO_NUL)]
"""Unique name of one write, made by its client; the same write again is stored once."""


class Verdict(StrEnum):
    """Verdict of a person: the stream, or streams, whose labels are wrong.

    UNSURE and DUPLICATE decide nothing about the streams. WITHDRAWN is the event of an undo.
    """

    SUPERVISED = "supervised"
    SELF_SUPERVISED = "self_supervised"
    BOTH = "both"
    NEITHER = "neither"
    UNSURE = "unsure"
    DUPLICATE = "duplicate"
    WITHDRAWN = "withdrawn"


GIVEN: Final = tuple(each for each in Verdict if each is not Verdict.WITHDRAWN)
"""Verdicts that a reviewer gives."""

DECIDED: Final = frozenset(
    {Verdict.SUPERVISED, Verdict.SELF_SUPERVISED, Verdict.BOTH, Verdict.NEITHER}
)
"""Verdicts that decide which stream is wrong."""

RIGHT: Final = frozenset({Verdict.SUPERVISED, Verdict.BOTH})
"""Verdicts by which a scene was rightly shown: the supervised stream is wrong."""

Standing = Literal["current", "replaced", "withdrawn"]
"""State of the record that was judged: still shown; its scene has another record now, because it
was mined again; its scene is no longer current.
"""


class VerdictRecord(BaseModel):
    """One event of the verdicts, numbered; published as `counterpoint.verdict.v1`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    ordinal: Count = Field(description="Number of the event, which rises by one over the ledger.")
    key: WriteKey = Field(description="Name of the write, made by its client.")
    scene_id: SceneId = Field(description="`<log_id>/<lidar>/<start_ns>`.")
    sha256: Digest = Field(description="Digest of the record that was judged.")
    track_id: Tally | None = Field(
        default=None, description="Track that was judged, as in the record; null: the scene."
    )
    reviewer: Name = Field(description="The person who judged.")
    verdict: Verdict = Field(
        description="The stream that is wrong; `withdrawn`: the reviewer's last verdict on this "
        "scene or track is undone, and the one before it counts again."
    )
    cause: Cause = Field(default="", description="Cause of the error; empty: none was given.")
    note: Note = Field(default="", description="The reviewer's own words.")
    duplicate_of: SceneId | None = Field(
        default=None, description="With `duplicate`: the scene that shows the same; null: unnamed."
    )
    judged_s: Seconds = Field(description="When it was stored, seconds since the Unix epoch.")
    took_s: Seconds | None = Field(
        default=None, description="Time the reviewer took, seconds; null: not measured."
    )


class VerdictRow(VerdictRecord):
    """One event in a list: the event, and its state now."""

    is_current: bool = Field(description="It counts: neither undone nor replaced by a later one.")
    record: Standing = Field(
        description="State of the judged record: `current`; `replaced`: the scene was mined again "
        "and has another record; `withdrawn`: the scene is no longer current."
    )


class VerdictSummary(BaseModel):
    """Counts of the verdicts on one scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    supervised: Count = Field(default=0, description="Verdicts on the scene by this value.")
    self_supervised: Count = Field(default=0, description="The same.")
    both: Count = Field(default=0, description="The same.")
    neither: Count = Field(default=0, description="The same.")
    unsure: Count = Field(default=0, description="The same.")
    duplicate: Count = Field(default=0, description="The same.")
    tracks: Count = Field(default=0, description="Verdicts on single tracks of the scene.")
    earlier: Count = Field(
        default=0, description="Verdicts on earlier records of the scene, which was mined again."
    )
    mine: Verdict | None = Field(
        default=None, description="The asking reviewer's verdict on the scene; null: none."
    )
    last_s: Seconds | None = Field(
        default=None, description="Last verdict, seconds since the Unix epoch; null: none."
    )

    @property
    def judged(self) -> int:
        """Number of verdicts on the shown record, those on its tracks included."""
        return sum(int(getattr(self, value.value)) for value in GIVEN) + self.tracks

    @property
    def text(self) -> str:
        """The counts in a few words, such as `supervised 2, unsure`; empty without a verdict."""
        counts = [(value.value, int(getattr(self, value.value))) for value in GIVEN]
        counts.append(("tracks", self.tracks))
        return ", ".join(f"{name} {n}" if n > 1 else name for name, n in counts if n)


VERDICT_ENCODING: Final = ("application/json", "counterpoint.verdict.v1")
"""Zenoh encoding and schema suffix of one verdict."""
