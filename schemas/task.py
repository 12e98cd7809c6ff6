"""Labelling task of both streams: the classes that every point gets one of, by name."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from schemas.errors import PermanentError

MAX_CLASSES: Final = 15
"""Classes of a task at most, so that all agreements and NOT_COMPARED fit a byte."""


class UnknownTaskError(PermanentError):
    """A record or an overlay is about a task that this version does not know."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One agreement of a task: the pair of labels of a point, by code and by name.

    Attributes:
        code: Value in an array of agreements.
        name: `both_static`, `only_semantic_dynamic`, ..., `not_compared`: the name in records and
            metrics.
        semantic: Class that the supervised stream labels; empty where not compared.
        predictive: Class that the self-supervised stream labels; empty where not compared.
        measured: True if only the self-supervised stream labels the point moving, and so measured
            its velocity.
        of_witness: True if neither stream labels the point moving, but the third witness does.
    """

    code: int
    name: str
    semantic: str = ""
    predictive: str = ""
    measured: bool = False
    of_witness: bool = False

    @property
    def contradicts(self) -> bool:
        """True if the two streams label different classes."""
        return self.semantic != self.predictive


@dataclass(frozen=True)
class Task:
    """A task that both streams label with the same classes, or with `unknown`.

    A label is the index of its class; `unknown` means that there is no label. The agreement of two
    labels is `predictive * K + semantic` over K classes, and K * K where either is unknown. For two
    classes these are the two bits 0b00 to 0b11, and 0b100.

    Attributes:
        name: Name of the task in a record.
        classes: Classes of a stream, in the order of labels; the first is the commonest, and
            pictures show it as background.
        moving: Class of moving points, for which a speed is measured and a witness is used; empty
            without one. Never the first.
        of_things: True if only contradictions of the size of a road user count; false if any size
            counts, since surfaces contradict.

    Raises:
        ValueError: If there are fewer than two classes, too many, or a name twice.
    """

    name: str
    classes: tuple[str, ...]
    moving: str = field(default="", kw_only=True)
    of_things: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        """Check the classes."""
        named = len(set(self.classes)) == len(self.classes) and all(self.classes)
        if not (named and 2 <= len(self.classes) <= MAX_CLASSES):
            raise ValueError(
                f"task {self.name} needs 2 to {MAX_CLASSES} different classes, got {self.classes}"
            )
        if self.moving and self.moving not in self.classes[1:]:
            raise ValueError(f"task {self.name} has no class {self.moving!r} that could move")

    @property
    def unknown(self) -> int:
        """Label of a point without a class."""
        return len(self.classes)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of every label, `unknown` last."""
        return (*self.classes, "unknown")

    @property
    def not_compared(self) -> int:
        """Agreement of a point that either stream leaves unknown; the highest code."""
        return len(self.classes) ** 2

    @cached_property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Every agreement, by code."""
        pairs = ((semantic, p) for p in self.classes for semantic in self.classes)
        told = (
            Outcome(
                code,
                self._name_of(semantic, predictive),
                semantic,
                predictive,
                measured=predictive == self.moving != semantic,
            )
            for code, (semantic, predictive) in enumerate(pairs)
        )
        return (*told, Outcome(self.not_compared, "not_compared"))

    @cached_property
    def kinds(self) -> tuple[Outcome, ...]:
        """Kinds of contradiction: of the two streams, by code, and of the witness with both."""
        told = tuple(outcome for outcome in self.outcomes if outcome.contradicts)
        if not self.moving:
            return told
        rest = self.classes[0]
        return (*told, Outcome(0, f"only_witness_{self.moving}", rest, rest, of_witness=True))

    def compared(self) -> Iterator[Outcome]:
        """Yield the agreements of points that both streams labelled, by code."""
        return iter(self.outcomes[:-1])

    def kind(self, name: str) -> Outcome:
        """Find a kind of contradiction by its name.

        Raises:
            UnknownTaskError: If the task has none of that name.
        """
        for kind in self.kinds:
            if kind.name == name:
                return kind
        known = ", ".join(kind.name for kind in self.kinds)
        raise UnknownTaskError(f"no contradiction {name!r} in task {self.name}; known: {known}")

    def _name_of(self, semantic: str, predictive: str) -> str:
        """Return an outcome's name: `both_` or `only_` for two classes, both labels for more."""
        if semantic == predictive:
            return f"both_{semantic}"
        if len(self.classes) > 2:
            return f"semantic_{semantic}_predictive_{predictive}"
        stream = "semantic" if semantic == self.classes[1] else "predictive"
        return f"only_{stream}_{self.classes[1]}"


MOTION: Final = Task("motion", ("static", "dynamic"), moving="dynamic")
"""Task of the paper; `schemas.labels` names its labels and agreements."""

GROUND: Final = Task("ground", ("other", "ground"), of_things=False)
"""Task of labelling points on surfaces that can be driven or walked on."""

TASKS: Final = {task.name: task for task in (MOTION, GROUND)}


def task_named(name: str) -> Task:
    """Find a task.

    Raises:
        UnknownTaskError: If there is none of that name.
    """
    try:
        return TASKS[name]
    except KeyError:
        raise UnknownTaskError(f"no task {name!r}; known: {', '.join(TASKS)}") from None
