"""Scenes that are exported: record, points and log, each opened when a format asks for it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from pydantic import BaseModel, ConfigDict, Field

from schemas.excerpt import ExcerptSource, LogExcerpt, SceneCloud
from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.curation.ranking import RankedScene
from service.export.points import LabelledCloud, PointLabels


class JudgedTrack(BaseModel):
    """One verdict of a reviewer, as an export carries it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    track_id: int | None = Field(default=None, description="Track as in the record; null: scene.")
    reviewer: str = Field(description="The person who judged.")
    verdict: str = Field(description="The stream that is wrong, or why none was named.")
    cause: str = Field(default="", description="Cause of the error; empty: none was given.")
    note: str = Field(default="", description="The reviewer's own words.")


@dataclass(eq=False)
class SceneToExport:
    """One scene of a selection.

    Attributes:
        number: Its place in the selection, 0 first.
        selection: Name of the selection.
        row: Its row of the selection.
        score: Its record.
        sha256: Digest of its record.
        verdicts: Verdicts of reviewers that count.
        open_overlay: Reads and decodes its overlay.
        source: Opens its log; None where no bucket is named.
    """

    number: int
    selection: str
    row: RankedScene
    score: SceneScore
    sha256: str
    verdicts: Sequence[JudgedTrack]
    open_overlay: Callable[[], Overlay]
    source: ExcerptSource | None = None

    @cached_property
    def overlay(self) -> Overlay:
        """Its points with the agreement of both streams.

        Raises:
            PermanentError: If there is none, or it is damaged.
        """
        return self.open_overlay()

    @cached_property
    def labels(self) -> PointLabels:
        """Pre-labels of its points."""
        return PointLabels(self.overlay, self.score)

    @property
    def opened(self) -> ExcerptSource:
        """The source of its log; the command names a bucket for every format that reads logs."""
        if self.source is None:
            raise ValueError("this format reads logs, and no bucket was named")
        return self.source

    def excerpt(self) -> LogExcerpt:
        """Find its log.

        Raises:
            PermanentError: If the log is gone.
        """
        return self.opened.cut(self.score, self.overlay)

    def clouds(self) -> Iterator[LabelledCloud]:
        """Yield its frames with pre-labels, in order.

        Raises:
            PermanentError: If the log is gone, or no longer has them.
        """
        return map(self.labelled, self.excerpt().clouds())

    def labelled(self, cloud: SceneCloud) -> LabelledCloud:
        """Give the points of a frame their pre-labels."""
        return self.labels.of(cloud)

    def release(self) -> None:
        """Free its points; a selection of scenes does not fit in memory."""
        for name in ("overlay", "labels"):
            self.__dict__.pop(name, None)

    @property
    def stem(self) -> str:
        """Name of its file or folder: number, log and begin; the same in every run."""
        log = self.score.log_id.rpartition("/")[2]
        safe = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "-" for c in log)
        return f"{self.number:04d}-{safe[:80]}-{self.score.start_ns}"
