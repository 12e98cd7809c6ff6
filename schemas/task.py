"""What two streams are asked about every point: the classes they choose from, by name."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from schemas.errors import PermanentError

MAX_CLASSES: Final = 15
"""Agreements of so many classes, and of none, fit a byte."""


class UnknownTaskError(PermanentError):
    """A record or an overlay is about a task that this version does not know."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One agreement of a task: what the two streams say of a point, by code and by name.

    Attributes:
        code: Value in an array of agreements.
        name: `both_static`, `only_semantic_dynamic`, ..., `not_compared`: as records and metrics
            say it.
        semantic: Class that the supervised stream says; empty where not compared.
        predictive: Class that the self-supervised stream says; empty where not compared.
        measured: The self-supervised stream alone says that the point moves: only then it measured
            how fast.
        of_witness: Neither stream says that the point moves, the third witness does.
    """

    code: int
    name: str
    semantic: str = ""
    predictive: str = ""
    measured: bool = False
    of_witness: bool = False

    @property
    def contradicts(self) -> bool:
        """Whether the two streams say different classes."""
        return self.semantic != self.predictive


@dataclass(frozen=True)
class Task:
    """A question that both streams answer with one of the same classes, or not at all.

    A label is the index of its class, and `unknown` stands for no answer. The agreement of two
    labels is `predictive * K + semantic` over K classes, and K * K where either is unknown: for two
    classes the two bits 0b00 to 0b11, and 0b100.

    Attributes:
        name: What a record calls it.
        classes: What a stream may say, in the order of labels; the first is what most of the world
            is, and pictures show it as background.
        moving: The class of what moves, for which a speed is measured and a witness is asked; empty
            without one. Never the first.
        of_things: A contradiction is worth a look if it has the size of a road user; else of any
            size, since surfaces contradict.

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
        """Label of a point that a stream says nothing about."""
        return len(self.classes)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of every label, `unknown` last."""
        return (*self.classes, "unknown")

    @property
    def not_compared(self) -> int:
        """Agreement of a point that either stream says nothing about; the highest code."""
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
        """What can contradict: two streams each other, by code, and a witness of motion both."""
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
        """Two classes are told apart by who alone says the second; more need both answers."""
        if semantic == predictive:
            return f"both_{semantic}"
        if len(self.classes) > 2:
            return f"semantic_{semantic}_predictive_{predictive}"
        stream = "semantic" if semantic == self.classes[1] else "predictive"
        return f"only_{stream}_{self.classes[1]}"


MOTION: Final = Task("motion", ("static", "dynamic"), moving="dynamic")
"""The paper's: `schemas.labels` names its labels and agreements."""

GROUND: Final = Task("ground", ("other", "ground"), of_things=False)
"""Which points lie on what can be driven or walked on."""

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
