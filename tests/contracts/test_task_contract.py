"""What holds for every task, of two classes or of more: from labels to record, overlay, picture."""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from PIL import Image

from schemas.contradiction import LabelledFrame, Scene
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.task import GROUND, MOTION, TASKS, Outcome, Task
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from schemas.transport.wire import decode, encode_scene_score
from service.pictures.scene import draw_camera, draw_scene
from service.pictures.style import colours_of, meaning
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, shard_of
from tests.overlays import labels_of_points
from workers.contradiction.agreement import compare
from workers.contradiction.overlay import overlay_of
from workers.errors import TasksDifferError
from workers.mine import MiningReport
from workers.parts.protocols import NoWitness, Parts, Witness
from workers.pipeline import MinedScene, mine_shard

USERS = Task("users", ("rest", "car", "person"), moving="person")
SURFACE = Task("surface", ("road", "grass", "wall", "water"), of_things=False)
MADE_UP = (USERS, SURFACE)


@pytest.fixture(autouse=True)
def made_up_tasks_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    for task in MADE_UP:
        monkeypatch.setitem(TASKS, task.name, task)


@pytest.fixture(params=[MOTION, GROUND, *MADE_UP], ids=lambda task: str(task.name))
def task(request: pytest.FixtureRequest) -> Task:
    found: Task = request.param
    return found


@dataclass(frozen=True)
class _Standing:
    """Odometry of a sensor that stands."""

    version: str = "standing@0"

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        return (PosedFrame(frame, np.eye(4)) for frame in frames)


@dataclass(frozen=True)
class _Says:
    """A stream that says what a labelled scene has, frame by frame."""

    task: Task
    scene: Scene
    supervised: bool
    version: str = "said@0"
    class_names: tuple[str, ...] = CLASS_NAMES

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        for posed, made in zip(frames, self.scene.frames, strict=True):
            assert posed.frame.stamp_ns == made.stamp_ns
            yield made.semantic if self.supervised else made.predictive


def _things(task: Task) -> list[Thing]:
    """One thing for each pair of labels, unknown among them, each on its own."""
    labels = range(len(task.labels))
    return [
        Thing((8.0 * semantic - 10, 8.0 * predictive - 10, 0), semantic, predictive, points=150)
        for predictive, semantic in product(labels, labels)
    ]


def _mined(task: Task, witness: Witness | None = None) -> MinedScene:
    """Run the method itself on a world in which every pair of labels occurs."""
    scene = labelled_scene(_things(task), frames=20, task=task)
    parts = Parts(
        _Standing(),
        _Says(task, scene, True),
        _Says(task, scene, False),
        witness=witness or NoWitness(),
    )
    frames = (frame.posed.frame for frame in scene.frames)
    (mined,) = mine_shard(shard_of(), frames, parts, pipeline_version="0")
    return mined


def test_agreements_of_all_pairs_are_the_codes_of_their_outcomes(task: Task) -> None:
    labels = np.arange(len(task.labels), dtype=np.uint8)
    semantic, predictive = np.tile(labels, len(labels)), np.repeat(labels, len(labels))
    agreements = compare(semantic, predictive, task)
    assert agreements.dtype == np.uint8
    for code, one, other in zip(agreements.tolist(), semantic, predictive, strict=True):
        outcome = task.outcomes[code]
        if task.unknown in (one, other):
            assert outcome.name == "not_compared"
        else:
            said = task.classes[one], task.classes[other]
            assert (outcome.semantic, outcome.predictive) == said


def test_each_kind_is_found_tied_scored_and_told(task: Task) -> None:
    mined = _mined(task)
    record = mined.score
    assert record.task == task.name
    assert record.score > 0
    assert {total.kind: total.tracks for total in record.totals} == {
        kind.name: int(not kind.of_witness) for kind in task.kinds
    }
    assert {track.kind for track in record.tracks} == {kind.name for kind in _told(task)}
    pairs = len(task.classes) ** 2
    assert record.compared_share == pytest.approx(pairs / len(task.labels) ** 2, abs=1e-4)
    for shares in (record.all_points, record.nonground_points):
        for outcome in task.compared():
            assert shares[outcome.name] == pytest.approx(1 / pairs, abs=1e-4)
    assert record.health is not None
    assert record.health.unknown_share == pytest.approx(1 / len(task.labels), abs=1e-4)
    for reason in record.reasons:
        motion = "measures" in reason.headline or "its shape stays" in reason.headline
        named = [name for name in task.classes if f" {name}" in reason.headline]
        assert motion or named
        assert not motion or task.moving


def test_record_and_overlay_come_back_with_their_task(task: Task) -> None:
    mined = _mined(task)
    record = encode_scene_score(mined.score)
    assert decode(SceneScore, record) == mined.score
    assert (b'"task"' in record) == (task is not MOTION)
    overlay = overlay_of(mined.scene, mined.instances, mined.tracks, class_names=CLASS_NAMES)
    again = decode_overlay(encode_overlay(overlay))
    assert again.task == task
    np.testing.assert_array_equal(again.agreements, overlay.agreements)
    assert set(again.instance_kind.tolist()) == {kind.code for kind in _told(task)}


def test_the_picture_shows_each_contradiction_in_a_colour_of_its_own(task: Task) -> None:
    colours = colours_of(task)
    assert len(set(colours.values())) == len(task.outcomes)
    assert len({meaning(outcome, task) for outcome in task.outcomes}) == len(task.outcomes)
    mined = _mined(task)
    overlay = overlay_of(mined.scene, mined.instances, mined.tracks, class_names=CLASS_NAMES)
    above = draw_scene(mined.score, overlay)
    for kind in _told(task):
        assert _pixels_of(above, colours[kind.code]) > 0, kind.name


def test_the_camera_shows_all_that_was_compared_and_names_it(task: Task) -> None:
    overlay = _one_of_each(task)
    at_px = np.array([[40.0 * place + 20, 40.0] for place in range(len(task.outcomes))])
    photo = _photo(max(1600, 40 * len(at_px)))
    drawn = draw_camera(
        photo, overlay, frame=0, at_px=at_px, inside_mask=np.ones(len(at_px), np.bool_)
    )
    for code, (x, y) in enumerate(at_px.astype(int)):
        said = drawn.getpixel((int(x), int(y)))
        assert (said == colours_of(task)[code]) == (code != task.not_compared)


def test_streams_of_different_tasks_are_refused_by_name() -> None:
    scene = labelled_scene(_things(MOTION), frames=2)
    with pytest.raises(TasksDifferError, match="task motion, the self-supervised one users"):
        Parts(_Standing(), _Says(MOTION, scene, True), _Says(USERS, scene, False))


def test_a_record_that_names_outcomes_of_another_task_is_refused(task: Task) -> None:
    record = _mined(task).score.model_dump()
    other = next(each for each in (MOTION, GROUND) if each is not task)
    with pytest.raises(ValueError, match="shares of task"):
        SceneScore.model_validate(record | {"task": other.name})
    with pytest.raises(ValueError, match="no task 'colour'"):
        SceneScore.model_validate(record | {"task": "colour"})


def test_the_account_counts_returns_by_the_names_of_the_labels(task: Task) -> None:
    report = MiningReport()
    report.add(_mined(task).scene.frames)
    assert list(report.labels) == list(task.labels)
    assert len(set(report.labels.values())) == 1  # as many things of each


@dataclass(frozen=True)
class _SeesAllMove:
    """A witness that says of every point that it moves."""

    version: str = "all@0"

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        for frame in frames:
            moves = np.full(len(frame.agreements), MotionLabel.DYNAMIC, np.uint8)
            sure = np.full(len(moves), 0.9, np.float16)
            yield replace(frame, witness=FrameLabels(moves, sure))


def test_a_witness_of_motion_contradicts_both_where_neither_says_moving(task: Task) -> None:
    mined = _mined(task, _SeesAllMove())
    found = [each for each in mined.instances if each.kind.of_witness]
    if not task.moving:
        assert not found
        return
    moving = task.classes.index(task.moving)
    for instance in found:
        frame = mined.scene.frames[instance.frame_index]
        semantic = frame.semantic.labels[instance.point_index]
        assert not np.isin(semantic, (moving, task.unknown)).any()
        assert (frame.predictive.labels[instance.point_index] != moving).all()
    assert found
    assert f"only_witness_{task.moving}" in {track.kind for track in mined.score.tracks}


def _told(task: Task) -> list[Outcome]:
    """Kinds in which the two streams contradict each other."""
    return [kind for kind in task.kinds if kind.contradicts]


def _one_of_each(task: Task) -> Overlay:
    scene = labelled_scene([Thing((5, 0, 0), 0, 0, points=len(task.outcomes))], frames=1, task=task)
    made = overlay_of(scene, (), (), class_names=CLASS_NAMES)
    agreements = np.arange(len(task.outcomes), dtype=np.uint8)
    return replace(made, **labels_of_points(agreements, task))


def _photo(width: int) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, 80), (90, 90, 90)).save(out, format="PNG")
    return out.getvalue()


def _pixels_of(image: Image.Image, colour: tuple[int, int, int]) -> int:
    pixels = np.asarray(image.convert("RGB"))
    return int((pixels == np.array(colour, dtype=np.uint8)).all(axis=2).sum())
