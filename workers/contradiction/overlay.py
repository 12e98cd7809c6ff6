"""Overlay of a mined scene: every point with its agreement, confidences and instance."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.contradiction import Instance, LabelledFrame, Scene
from schemas.labels import FrameLabels
from schemas.overlay import MAX_CLASSES, NO_POSITION_CM, Overlay, OverlayLidar
from schemas.overlay_picture import Picture
from workers.contradiction.track_score import RankedTrack
from workers.points.point_kernels import in_centimetres

_REACH_M: Final = np.float32(327.0)
_BOX_DIGITS: Final = 3
"""Decimals of boxes, metres and radians: the header of an overlay spells them out."""


def overlay_of(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: Sequence[RankedTrack],
    *,
    class_names: Sequence[str],
    pictures: Sequence[Picture] = (),
    scoring_inputs: bytes = b"",
) -> Overlay:
    """Build the overlay of a scene.

    Args:
        scene: Its labelled frames.
        instances: Its instances, from `find_instances`.
        ranked: Their tracks, in the order of the scene's record.
        class_names: Names that the supervised stream's class ids index. Of more than 255 the
            commonest in the scene are kept, and points of the others have none.
        pictures: Camera pictures to keep with it.
        scoring_inputs: Inputs of its score, encoded; empty: none.

    Returns:
        The overlay: points in the order of the log, tracks numbered as in the scene's record.
    """
    frames = scene.frames
    class_id = _gather(frames, lambda frame: _or(frame.semantic.class_id, frame, np.int16(-1)))
    class_id, names = _kept_classes(class_id, class_names)
    lengths = [len(frame.posed.frame) for frame in frames]
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    index = np.full(offsets[-1], -1, dtype=np.int32)
    for i, instance in enumerate(instances):
        index[offsets[instance.frame_index] + instance.point_index] = i
    boxes = [np.concatenate([i.centre_m, i.size_m, [i.yaw_rad]]) for i in instances]
    return Overlay(
        scene_id=scene.scene_id,
        stamps_ns=np.array([frame.stamp_ns for frame in frames], dtype=np.int64),
        offsets=offsets,
        points_cm=_gather(frames, _points_cm),
        semantic_labels=_gather(frames, lambda frame: frame.semantic.labels),
        predictive_labels=_gather(frames, lambda frame: frame.predictive.labels),
        witness_labels=_gather(frames, _witness_labels),
        ground_mask=_gather(frames, lambda frame: _or(frame.predictive.ground_mask, frame, False)),
        class_id=class_id,
        class_names=names,
        semantic_confidence=_gather(frames, lambda frame: _to_byte(frame.semantic)),
        predictive_confidence=_gather(frames, lambda frame: _to_byte(frame.predictive)),
        instance_index=index,
        odom_from_sensor=np.stack([frame.posed.odom_from_sensor for frame in frames]),
        instance_frame=np.array([i.frame_index for i in instances], dtype=np.int32),
        instance_kind=np.array([i.kind.code for i in instances], dtype=np.uint8),
        instance_track=tracks_of(len(instances), ranked),
        instance_boxes=np.round(boxes, _BOX_DIGITS).astype(np.float32).reshape(-1, 7),
        task=scene.task,
        lidars=_lidars(frames),
        pictures=tuple(pictures),
        scoring_inputs=scoring_inputs,
    )


def _lidars(frames: Sequence[LabelledFrame]) -> tuple[OverlayLidar, ...]:
    """Return the further lidars of a scene, with their points in each frame."""
    of_frame = [frame.posed.frame.joined for frame in frames]
    return tuple(
        OverlayLidar(
            topic=seen[0].topic,
            points=np.array([each.points for each in seen], dtype=np.int64),
            stamps_ns=np.array([each.stamp_ns for each in seen], dtype=np.int64),
            main_from_lidar=np.round([each.main_from_lidar for each in seen], 6),
        )
        for seen in zip(*of_frame, strict=True)
    )


def tracks_of(instances: int, ranked: Sequence[RankedTrack]) -> NDArray[np.int32]:
    """Return the number of the track of each instance, in the order of the record; -1: none."""
    track = np.full(instances, -1, dtype=np.int32)
    for track_id, each in enumerate(ranked):
        track[list(each.track.members)] = track_id
    return track


def _kept_classes(
    class_id: NDArray[np.int16], names: Sequence[str]
) -> tuple[NDArray[np.int16], tuple[str, ...]]:
    """Number the commonest classes from 0 on where there are more than an overlay keeps."""
    if len(names) <= MAX_CLASSES:
        return class_id, tuple(names)
    counts = np.bincount(class_id + 1, minlength=len(names) + 1)[1:]
    kept = np.sort(np.argsort(-counts, kind="stable")[:MAX_CLASSES])
    number = np.full(len(names) + 1, -1, dtype=np.int16)  # the last one is of class -1
    number[kept] = np.arange(len(kept))
    return number[class_id], tuple(names[i] for i in kept)


def _gather(
    frames: Sequence[LabelledFrame], take: Callable[[LabelledFrame], NDArray[Any]]
) -> NDArray[Any]:
    return np.concatenate([take(frame) for frame in frames])


def _points_cm(frame: LabelledFrame) -> NDArray[np.int16]:
    points_m, valid = frame.posed.frame.points_m, frame.posed.frame.valid_mask
    return in_centimetres(points_m, valid, _REACH_M, np.int16(NO_POSITION_CM))


def _or(
    array: NDArray[Any] | None, frame: LabelledFrame, otherwise: bool | np.int16
) -> NDArray[Any]:
    return np.full(len(frame.agreements), otherwise) if array is None else array


def _witness_labels(frame: LabelledFrame) -> NDArray[np.uint8]:
    if frame.witness is None:
        return np.full(len(frame.agreements), frame.task.unknown, dtype=np.uint8)
    return frame.witness.labels


def _to_byte(labels: FrameLabels) -> NDArray[np.uint8]:
    fifteenths = np.rint(labels.confidence.astype(np.float32) * np.float32(15))
    return np.asarray(fifteenths * 17, dtype=np.uint8)
