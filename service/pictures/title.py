"""Title of a picture: rank, score and short name of its scene; and the labels of its tracks."""

from dataclasses import dataclass
from typing import Final

from schemas.contradiction import TrackRecord
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from service.curation.scene_names import begins

MOST_LABELS: Final = 10
"""Tracks that a picture labels by number and class."""


@dataclass(frozen=True, slots=True)
class Title:
    """Rank and name of a scene.

    Attributes:
        score: Its score.
        name: Its short name.
        rank: Its place in the ranking; None where it was not ranked.
    """

    score: float
    name: str
    rank: int | None = None

    @property
    def place(self) -> str:
        """Rank and short name in a line."""
        return f"rank {self.rank} | {self.name}" if self.rank else self.name

    @property
    def text(self) -> str:
        """Rank, score and short name in a line."""
        return f"{f'rank {self.rank} | ' if self.rank else ''}{self.score:.3f} | {self.name}"


def title_of(score: SceneScore, *, rank: int | None = None, name: str = "") -> Title:
    """Return the title of a scene; without a name it is the last part of the log's."""
    own = f"{score.log_id.rpartition('/')[2]}@{begins(score.start_ns)}"
    return Title(score.score, name or own, rank)


def shown_tracks(score: SceneScore, *, most: int = MOST_LABELS) -> list[TrackRecord]:
    """Return the tracks that a picture names: strong ones, and in any case the first one.

    Weaker ones have boxes without a number; they are no reason of the score.
    """
    strong = [track for track in score.tracks if track.strength >= MIN_REPORTED_STRENGTH]
    return (strong or list(score.tracks[:1]))[:most]


def labels_of(score: SceneScore) -> list[tuple[int, str]]:
    """Return number and text for each track that is named, the same on all pictures."""
    return [
        (track.track_id, f"{track.track_id + 1} {track.class_name or 'object'}")
        for track in shown_tracks(score)
    ]
