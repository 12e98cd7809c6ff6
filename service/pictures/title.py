"""Title of a picture: rank, score and short name of its scene; and the labels of its tracks."""

from dataclasses import dataclass

from schemas.score import SceneScore, shown_tracks
from service.curation.scene_names import begins


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


def labels_of(score: SceneScore) -> list[tuple[int, str]]:
    """Return number and text for each track that is named, the same on all pictures."""
    return [
        (track.track_id, f"{track.track_id + 1} {track.class_name or 'object'}")
        for track in shown_tracks(score)
    ]
