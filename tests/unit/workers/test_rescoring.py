"""The record of a scene, computed again from the inputs that its overlay keeps."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.contradiction import Scene
from schemas.frame import OdometryState, RecordedFix
from schemas.labels import MotionLabel
from schemas.surroundings import EARTH
from schemas.task import GROUND
from schemas.transport.array_pack import joined, parted
from schemas.transport.wire import encode_scene_score
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, shard_of
from tests.unit.service.test_picture import _Streams as Streams
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.feature_extraction import extract_features
from workers.contradiction.instances import find_instances
from workers.contradiction.rescoring import rescored
from workers.contradiction.scene_statistics import statistics_of
from workers.contradiction.score import score_scene
from workers.contradiction.scoring_inputs import (
    ScoringInputs,
    ScoringInputsUnreadableError,
    decode_inputs,
    encode_inputs,
    inputs_of,
)
from workers.contradiction.track_score import rank_tracks
from workers.contradiction.tracks import associate_instances

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC
MISSED = Thing((-8, 6, 0), STATIC, DYNAMIC, velocity_m_per_s=(6, 0, 0), points=900)
PHANTOM = Thing((12, -6, 0), DYNAMIC, STATIC, class_id=2, size_m=(3, 2, 1.7), points=90)
WALL = Thing((0, 15, 1), STATIC, STATIC, size_m=(40, 1.0, 4), points=900)
LATE = [OdometryState.HEALTHY] * 7 + [OdometryState.DEGRADED] * 2


def _scored(scene: Scene) -> tuple[bytes, ScoringInputs]:
    instances = find_instances(scene, class_names=CLASS_NAMES)
    described = extract_features(scene, instances, associate_instances(scene, instances))
    ranked = rank_tracks(scene, described, attribute_tracks(described))
    score = score_scene(
        *(shard_of(), scene, instances, ranked), parts=Streams(), pipeline_version="abcdef012345"
    )
    inputs = inputs_of(
        *(score, scene, instances, described, statistics_of(scene)), own_model=Streams.own_model
    )
    return encode_scene_score(score), inputs


def _on_earth(scene: Scene) -> Scene:
    """Return the scene with a fix in each frame."""
    frames = []
    for number, frame in enumerate(scene.frames):
        fix = RecordedFix(frame.stamp_ns, EARTH, (48.1, 11.5 + 1e-5 * number))
        cloud = replace(frame.posed.frame, fixes=(fix,))
        frames.append(replace(frame, posed=replace(frame.posed, frame=cloud)))
    return replace(scene, frames=tuple(frames))


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(labelled_scene([WALL, MISSED, PHANTOM], frames=12), id="a scene"),
        pytest.param(
            _on_earth(labelled_scene([WALL, MISSED], frames=12, ego_m_per_s=7.3)), id="a place"
        ),
        pytest.param(
            labelled_scene([MISSED, PHANTOM], frames=9, ego_m_per_s=7.3, odometry=LATE),
            id="doubted poses",
        ),
        pytest.param(labelled_scene([WALL], frames=2), id="nothing contradicts"),
        pytest.param(labelled_scene([MISSED], frames=1, too_short=True), id="too short"),
        pytest.param(
            labelled_scene([MISSED], frames=3, odometry=[OdometryState.LOST] * 3), id="lost"
        ),
        pytest.param(labelled_scene([], frames=2), id="no point at all"),
        pytest.param(labelled_scene([WALL, PHANTOM], frames=4, task=GROUND), id="another task"),
    ],
)
def test_the_record_is_computed_again_byte_for_byte(scene: Scene) -> None:
    record, inputs = _scored(scene)
    payload = encode_inputs(inputs)
    again = decode_inputs(payload)
    assert encode_scene_score(rescored(again)) == record
    assert encode_inputs(again) == payload
    has_fix = any(frame.posed.frame.fixes for frame in scene.frames)
    assert (b'"place":{' in record) == has_fix


def test_floats_keep_all_their_bits() -> None:
    _, inputs = _scored(labelled_scene([MISSED, PHANTOM], frames=12))
    track = inputs.tracks[0]
    odd = replace(track.features, distance=0.1 + 0.2, length=5e-324, clutter=np.nextafter(1.0, 0))
    changed = replace(inputs, tracks=[replace(track, features=odd), *inputs.tracks[1:]])
    assert decode_inputs(encode_inputs(changed)).tracks[0].features == odd


def test_the_score_follows_the_stored_features() -> None:
    """A newly fitted table is evaluated on stored inputs, without the logs."""
    _, inputs = _scored(labelled_scene([MISSED, PHANTOM], frames=12))
    again = decode_inputs(encode_inputs(inputs))
    weak = [
        replace(each, features=replace(each.features, point_count=0.01)) for each in again.tracks
    ]
    assert rescored(replace(again, tracks=weak)).score < rescored(again).score


def test_inputs_of_other_features_are_refused() -> None:
    _, inputs = _scored(labelled_scene([MISSED], frames=5))
    meta, arrays = parted(memoryview(encode_inputs(inputs)))
    for change in ({"version": 1}, {"features": ["speed"]}):
        with pytest.raises(ScoringInputsUnreadableError, match="scores version 2 with 41"):
            decode_inputs(joined(meta | change, arrays))


@pytest.mark.parametrize("cut", [0, 3, 100, -1])
def test_truncated_inputs_are_refused(cut: int) -> None:
    _, inputs = _scored(labelled_scene([MISSED], frames=5))
    with pytest.raises(ScoringInputsUnreadableError, match=r"are damaged: .* mine the log again"):
        decode_inputs(encode_inputs(inputs)[:cut])


def test_inputs_that_do_not_fit_each_other_are_refused() -> None:
    _, inputs = _scored(labelled_scene([MISSED], frames=5))
    meta, arrays = parted(memoryview(encode_inputs(inputs)))
    for change in (
        {"track_members": arrays["track_members"] + 10_000},
        {"track_lengths": arrays["track_lengths"][:0]},
        {"instance_kind": arrays["instance_kind"] + 100},
        {"instance_frame": arrays["instance_frame"] + 100},
        {"odometry": arrays["odometry"][1:]},
        {"stamps_ns": arrays["stamps_ns"][:0]},
    ):
        with pytest.raises(ScoringInputsUnreadableError, match="are damaged"):
            decode_inputs(joined(meta, arrays | change))
