"""Flashes: what the supervised stream alone labels dynamic for less than half a second."""

import pytest

from schemas.contradiction import ContradictionKind, Scene
from schemas.labels import MotionLabel
from schemas.task import MOTION
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame, ranked_tracks
from workers.contradiction.flashes import label_time
from workers.contradiction.instances import find_instances
from workers.contradiction.track_score import RankedTrack

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
PLACE_M = (12.0, 4.0, 0.0)
ALL = frozenset(range(40))


def _track(
    flash: range,
    *,
    period_s: float = 0.1,
    semantic: MotionLabel = DYNAMIC,
    predictive: MotionLabel = STATIC,
    silent: range = range(0),
    scene: range = range(10, 30),
) -> RankedTrack:
    """Return the track of a parked car on which the streams contradict during a flash.

    Args:
        flash: Frames of the flash.
        period_s: Time between frames.
        semantic: Label of the supervised stream in them; else it labels the car static.
        predictive: Label of the self-supervised stream in them; else it labels the car static.
        silent: Frames of the flash in which the self-supervised stream has no label.
        scene: Frames of the scene; the others are before and after it.
    """
    called, open_ = frozenset(flash) - frozenset(silent), frozenset(silent) & frozenset(flash)
    things = [
        Thing(PLACE_M, STATIC, STATIC, frames=ALL - frozenset(flash)),
        Thing(PLACE_M, semantic, predictive, frames=called),
        Thing(PLACE_M, semantic, UNKNOWN, frames=open_),
    ]
    made = [labelled_frame(things, frame=n, time_s=n * period_s) for n in range(40)]
    whole = Scene(
        scene_id=f"fleet/car-1/drive/lidar/{START_NS}",
        frames=tuple(made[scene.start : scene.stop]),
        before=tuple(made[: scene.start]),
        after=tuple(made[scene.stop :]),
    )
    (track,) = ranked_tracks(whole, find_instances(whole, class_names=CLASS_NAMES))
    return track


def test_a_label_of_half_a_second_counts_and_a_flash_does_not() -> None:
    failure, flash = _track(range(15, 20)), _track(range(15, 18))
    assert failure.features.label_time == 1.0
    assert failure.strength > 0.4
    assert flash.features.label_time == pytest.approx(0.2)
    assert flash.strength < 0.15 * failure.strength
    assert failure.attribution is not None
    assert flash.attribution is not None
    assert "flash of the label" in flash.attribution.neutral
    assert "flash of the label" not in failure.attribution.neutral


def test_a_label_that_goes_on_beyond_the_scene_is_no_flash() -> None:
    assert _track(range(6, 12)).features.label_time == 1.0
    assert _track(range(28, 34)).features.label_time == 1.0
    assert _track(range(9, 12)).features.label_time == pytest.approx(0.2)


def test_frames_in_which_the_other_stream_is_silent_belong_to_the_label() -> None:
    assert _track(range(15, 20), silent=range(17, 20)).features.label_time == 1.0


def test_seconds_count_and_not_frames() -> None:
    assert _track(range(15, 17), period_s=0.25).features.label_time == 1.0
    assert _track(range(15, 20), period_s=0.05).features.label_time == 0.0


def test_a_missed_mover_that_is_proved_in_two_frames_loses_nothing() -> None:
    missed = _track(range(15, 17), semantic=STATIC, predictive=DYNAMIC)
    assert missed.track.kind.name == ContradictionKind.ONLY_PREDICTIVE_DYNAMIC
    assert missed.features.label_time == 1.0


def test_a_single_frame_is_not_asked() -> None:
    kind = MOTION.kind(ContradictionKind.ONLY_SEMANTIC_DYNAMIC)
    assert label_time(kind, MOTION, frames=1, period_s=0.0) == 1.0
    assert label_time(kind, MOTION, frames=1, period_s=0.1) == 0.0
