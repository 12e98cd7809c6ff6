"""The overlay of a mined scene: what it keeps of each point."""

from dataclasses import replace

import numpy as np

from schemas.contradiction import Scene
from schemas.labels import FrameLabels, MotionLabel
from schemas.overlay import MAX_CLASSES
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene
from workers.contradiction.instances import find_instances
from workers.contradiction.overlay import overlay_of

MISSED = Thing((-8, 6, 0), MotionLabel.STATIC, MotionLabel.DYNAMIC, points=900)
SILENT = Thing((9, 6, 0), MotionLabel.DYNAMIC, MotionLabel.UNKNOWN, points=400)


def _with_classes(scene: Scene, class_id: np.ndarray) -> Scene:
    (frame,) = scene.frames
    return replace(
        scene, frames=(replace(frame, semantic=replace(frame.semantic, class_id=class_id)),)
    )


def test_both_labels_are_kept_where_only_one_stream_labels() -> None:
    scene = labelled_scene([MISSED, SILENT], frames=2)
    overlay = decode_overlay(encode_overlay(overlay_of(scene, (), (), class_names=CLASS_NAMES)))
    for number, frame in enumerate(scene.frames):
        at = overlay.points_of(number)
        np.testing.assert_array_equal(overlay.semantic_labels[at], frame.semantic.labels)
        np.testing.assert_array_equal(overlay.predictive_labels[at], frame.predictive.labels)
        np.testing.assert_array_equal(overlay.agreements[at], frame.agreements)
    assert (overlay.predictive_labels == MotionLabel.UNKNOWN).any()
    assert (overlay.witness_labels == MotionLabel.UNKNOWN).all(), "none was asked"


def test_the_label_of_the_witness_is_kept() -> None:
    scene = labelled_scene([MISSED], frames=1)
    (frame,) = scene.frames
    labels = np.resize(np.arange(3, dtype=np.uint8), len(frame.agreements))
    witness = FrameLabels(labels, np.ones(len(labels), np.float16))
    asked = replace(scene, frames=(replace(frame, witness=witness),))
    overlay = decode_overlay(encode_overlay(overlay_of(asked, (), (), class_names=CLASS_NAMES)))
    np.testing.assert_array_equal(overlay.witness_labels, labels)


def test_boxes_are_kept_to_the_millimetre() -> None:
    scene = labelled_scene([MISSED], frames=3)
    instances = find_instances(scene, class_names=CLASS_NAMES)
    overlay = decode_overlay(
        encode_overlay(overlay_of(scene, instances, (), class_names=CLASS_NAMES))
    )
    for box, instance in zip(overlay.instance_boxes, instances, strict=True):
        np.testing.assert_allclose(box[:3], instance.centre_m, atol=0.0006)
        np.testing.assert_allclose(box[6], instance.yaw_rad, atol=0.0006)
    assert len(instances) == 3


def test_of_more_classes_than_a_byte_names_the_commonest_are_kept() -> None:
    scene = labelled_scene([Thing((9, 6, 0), 0, 0, points=900)], frames=1)
    names = tuple(f"class {number}" for number in range(400))
    points = len(scene.frames[0].agreements)
    class_id = np.arange(points).astype(np.int16) % 200 + 150  # 150 to 349
    class_id[:5] = (-1, 0, 1, 399, 399)
    made = overlay_of(_with_classes(scene, class_id), (), (), class_names=names)
    overlay = decode_overlay(encode_overlay(made))
    assert len(overlay.class_names) == MAX_CLASSES
    told = [overlay.class_names[i] if i >= 0 else "" for i in overlay.class_id.tolist()]
    assert told == [names[i] if i >= 0 else "" for i in class_id.tolist()]
    many = np.arange(points).astype(np.int16) % 400
    many[:300] = 399
    made = overlay_of(_with_classes(scene, many), (), (), class_names=names)
    kept = made.class_id >= 0
    assert (made.class_id[many == 399] >= 0).all(), "the commonest of all"
    assert not kept.all()
    for mine, theirs in zip(made.class_id[kept], many[kept], strict=True):
        assert made.class_names[mine] == names[theirs]
