from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from schemas.contradiction import ContradictionKind, Scene
from schemas.labels import MotionLabel
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame, labelled_scene
from workers.contradiction.evidence import Evidence
from workers.contradiction.instances import find_instances
from workers.contradiction.paths import path_of
from workers.contradiction.strength import rank_tracks

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC
SEMANTIC = ContradictionKind.ONLY_SEMANTIC_DYNAMIC


def _evidence(scene: Scene) -> Evidence:
    (track,) = rank_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    return track.evidence


def _scene(
    said: Sequence[tuple[int, int]], *, step_m: float, others: tuple[Thing, ...] = ()
) -> Scene:
    """A car of which both streams say something else in each frame, and what else is there."""
    frames = []
    for number, (semantic, predictive) in enumerate(said):
        car = Thing((12.0 + step_m * number, 5.0, 0.0), semantic, predictive)
        frames.append(labelled_frame([car, *others], frame=number, time_s=number / 10.0))
    return Scene(scene_id=f"fleet/car-1/drive/lidar/{START_NS}", frames=tuple(frames))


@pytest.mark.parametrize(
    ("said", "before", "after"),
    [
        ([(DYNAMIC, DYNAMIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(STATIC, STATIC)] * 4, 1.0, 0.0),
        ([(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(DYNAMIC, DYNAMIC)] * 4, 0.0, 1.0),
        ([(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(STATIC, STATIC)] * 4, 0.0, 0.0),
        ([(DYNAMIC, STATIC)] * 14, 0.0, 0.0),
    ],
    ids=["it stops", "it starts", "called moving for a while", "from end to end"],
)
@pytest.mark.parametrize("step_m", [0.0, 0.3], ids=["in its place", "as it goes"])
def test_what_both_call_moving_before_or_after_is_told(
    said: Sequence[tuple[int, int]], before: float, after: float, step_m: float
) -> None:
    evidence = _evidence(_scene(said, step_m=step_m))
    assert (evidence.agreed_before, evidence.agreed_after) == (before, after)


@pytest.mark.parametrize("step_m", [0.0, 0.3], ids=["in its place", "as it goes"])
def test_what_is_said_beyond_the_ends_of_the_scene_counts(step_m: float) -> None:
    said = [(DYNAMIC, DYNAMIC)] * 4 + [(DYNAMIC, STATIC)] * 10 + [(STATIC, STATIC)] * 4
    whole = _scene(said, step_m=step_m)
    cut = replace(whole, frames=whole.frames[4:14], before=whole.frames[1:4])
    alone = replace(cut, before=())
    assert (_evidence(cut).agreed_before, _evidence(cut).agreed_after) == (1.0, 0.0)
    assert _evidence(alone).agreed_before == 0.0


def test_a_mover_that_passes_beside_a_thing_says_nothing_of_it() -> None:
    said = [(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(STATIC, STATIC)] * 4
    beside = Thing((12.0, 9.0, 0.0), DYNAMIC, DYNAMIC, points=400)
    evidence = _evidence(_scene(said, step_m=0.0, others=(beside,)))
    assert (evidence.agreed_before, evidence.agreed_after) == (0.0, 0.0)


def test_a_path_of_two_frames_says_nothing() -> None:
    places_m = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    path = path_of(places_m, np.array([0.0, 0.1]))
    assert (path.went, path.straight) == (0.0, 0.0)
    assert not path.velocity_m_per_s.any()


@pytest.mark.parametrize(
    ("height_m", "range_m", "least", "most"),
    [(0.3, 10.0, 0.75, 0.85), (1.5, 10.0, 0.0, 0.0), (0.3, 60.0, 0.0, 0.0)],
    ids=["a lifted patch of road", "a car", "a far car of few rows"],
)
def test_low_is_what_is_near_and_has_no_height(
    height_m: float, range_m: float, least: float, most: float
) -> None:
    thing = Thing((range_m, 0.0, 0.0), DYNAMIC, STATIC, size_m=(3.0, 1.5, height_m))
    assert least <= _evidence(labelled_scene([replace(thing, points=200)])).low <= most
