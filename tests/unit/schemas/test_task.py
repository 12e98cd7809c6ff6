"""Tasks of any set of classes: codes, names and kinds of what two streams may say together."""

import pytest

from schemas.contradiction import ContradictionKind
from schemas.labels import Agreement, MotionLabel
from schemas.task import (
    GROUND,
    MAX_CLASSES,
    MOTION,
    TASKS,
    Task,
    UnknownTaskError,
    task_named,
)

SURFACE = Task("surface", ("road", "grass", "wall"))


def test_motion_is_the_task_whose_labels_agreements_and_kinds_have_names_of_their_own() -> None:
    assert {label.name.lower(): label.value for label in MotionLabel} == {
        name: label for label, name in enumerate(MOTION.labels)
    }
    assert {each.name.lower(): each.value for each in Agreement} == {
        outcome.name: outcome.code for outcome in MOTION.outcomes
    }
    assert [kind.name for kind in MOTION.kinds] == [kind.value for kind in ContradictionKind]


def test_only_the_self_supervised_stream_alone_measures_a_motion() -> None:
    assert [kind.name for kind in MOTION.kinds if kind.measured] == ["only_predictive_dynamic"]
    assert not any(kind.measured for kind in GROUND.kinds)


@pytest.mark.parametrize("task", [*TASKS.values(), SURFACE], ids=lambda task: str(task.name))
def test_each_pair_of_classes_is_one_outcome_and_its_code_is_its_place(task: Task) -> None:
    classes = len(task.classes)
    assert [outcome.code for outcome in task.outcomes] == list(range(classes**2 + 1))
    assert len({outcome.name for outcome in task.outcomes}) == len(task.outcomes)
    for outcome in task.compared():
        predictive, semantic = divmod(outcome.code, classes)
        assert (outcome.semantic, outcome.predictive) == (
            task.classes[semantic],
            task.classes[predictive],
        )
        assert outcome.contradicts == (semantic != predictive)
    assert sum(kind.contradicts for kind in task.kinds) == classes * (classes - 1)
    assert sum(kind.of_witness for kind in task.kinds) == bool(task.moving)
    assert task.outcomes[task.not_compared].name == "not_compared"
    assert not task.outcomes[task.not_compared].contradicts


def test_two_classes_are_told_apart_by_who_alone_says_the_second_and_three_by_both() -> None:
    assert [kind.name for kind in GROUND.kinds] == [
        "only_semantic_ground",
        "only_predictive_ground",
    ]
    assert SURFACE.outcomes[5].name == "semantic_wall_predictive_grass"
    assert SURFACE.kind("semantic_wall_predictive_grass").code == 5


def test_a_kind_or_task_that_does_not_exist_is_named_with_those_that_do() -> None:
    with pytest.raises(UnknownTaskError, match="only_predictive_dynamic"):
        MOTION.kind("both_static")
    with pytest.raises(UnknownTaskError, match=r"'colour'.*motion, ground"):
        task_named("colour")


@pytest.mark.parametrize(
    "classes", [("one",), ("same", "same"), ("a", ""), tuple(map(str, range(MAX_CLASSES + 1)))]
)
def test_classes_that_cannot_be_told_apart_are_refused(classes: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="different classes"):
        Task("wrong", classes)


@pytest.mark.parametrize("moving", ["flying", "a"])
def test_what_moves_must_be_a_class_and_not_the_background(moving: str) -> None:
    with pytest.raises(ValueError, match=f"'{moving}'"):
        Task("wrong", ("a", "b"), moving=moving)
