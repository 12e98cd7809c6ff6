"""Scoring inputs of a scene: the facts from which its score is computed again, bit for bit.

They are stored in the scene's overlay: the features of every track, what the ranking reads of every
instance and pose, and the statistics that the record states. Floats are stored with all 64 bits.
"""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from schemas.contradiction import Instance, LabelledFrame, Scene
from schemas.errors import PermanentError
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import FrameLabels
from schemas.score import Producers, SceneScore
from schemas.task import UnknownTaskError, task_named
from schemas.transport.array_pack import PackUnreadableError, joined, parted
from workers.contradiction.origin import Origin
from workers.contradiction.scene_statistics import SceneStatistics
from workers.contradiction.track_features import NAMES, DescribedTrack, TrackFeatures
from workers.contradiction.tracks import Track, centres_in_odom

VERSION: Final = 2
"""Version of the inputs; another set of features or statistics is another version."""

_STATES: Final = tuple(OdometryState)
_STATISTICS: Final = TypeAdapter(SceneStatistics)
_VALUES: Final = 13
"""Floats of an instance."""

_DAMAGED: Final = (KeyError, TypeError, ValueError, IndexError, ValidationError)


class ScoringInputsUnreadableError(PermanentError):
    """The inputs are damaged, or of another version than this program scores."""


@dataclass(frozen=True, slots=True, eq=False)
class ScoringInputs:
    """Everything that the score of one scene is computed from.

    Attributes:
        origin: Log, lidar, vehicle and software.
        producers: Versions of the streams and of the pipeline.
        own_model: Name of the user's own model; empty where the supervised stream is a shipped one.
        scene: The scene; in decoded inputs its frames have poses and no points.
        statistics: Its statistics.
        instances: Its instances. In decoded inputs `point_index` has their number of points, all 0,
            and the shares around them, which are in the features, have their defaults.
        tracks: Its tracks with their features, in the order of `associate_instances`.
    """

    origin: Origin
    producers: Producers
    own_model: str
    scene: Scene
    statistics: SceneStatistics
    instances: Sequence[Instance]
    tracks: Sequence[DescribedTrack]


def inputs_of(
    score: SceneScore,
    scene: Scene,
    instances: Sequence[Instance],
    tracks: Sequence[DescribedTrack],
    statistics: SceneStatistics,
    *,
    own_model: str,
) -> ScoringInputs:
    """Return the inputs of a scene that was scored."""
    return ScoringInputs(
        origin=Origin(*(getattr(score, each.name) for each in fields(Origin))),
        producers=score.producers,
        own_model=own_model,
        scene=scene,
        statistics=statistics,
        instances=instances,
        tracks=tracks,
    )


def encode_inputs(inputs: ScoringInputs) -> bytes:
    """Encode the inputs of a score, uncompressed; equal inputs give equal bytes."""
    scene, instances = inputs.scene, inputs.instances
    kinds = [kind.name for kind in scene.task.kinds]
    classes = sorted({instance.class_name for instance in instances})
    meta = {
        "version": VERSION,
        "origin": asdict(inputs.origin),
        "producers": inputs.producers.model_dump(mode="json"),
        "own_model": inputs.own_model,
        "scene_id": scene.scene_id,
        "task": scene.task.name,
        "too_short": scene.too_short,
        "statistics": _STATISTICS.dump_python(inputs.statistics, mode="json"),
        "features": list(NAMES),
        "classes": classes,
    }
    members = [m for track in inputs.tracks for m in track.track.members]
    arrays: dict[str, NDArray[Any]] = {
        "stamps_ns": np.array([frame.stamp_ns for frame in scene.frames], np.int64),
        "odometry": np.array([_STATES.index(f.posed.odometry) for f in scene.frames], np.uint8),
        "poses": _planes([frame.posed.odom_from_sensor.ravel() for frame in scene.frames], 16),
        "instance_frame": np.array([i.frame_index for i in instances], np.int32),
        "instance_kind": np.array([kinds.index(i.kind.name) for i in instances], np.uint8),
        "instance_class": np.array([classes.index(i.class_name) for i in instances], np.uint16),
        "instance_points": np.array([len(i.point_index) for i in instances], np.int32),
        "instance_values": _planes([_values(each) for each in instances], _VALUES),
        "track_lengths": np.array([len(t.track.members) for t in inputs.tracks], np.int32),
        "track_members": np.array(members, np.int32),
        "track_features": _planes([astuple(t.features) for t in inputs.tracks], len(NAMES)),
    }
    return joined(meta, arrays)


def decode_inputs(payload: bytes) -> ScoringInputs:
    """Decode the inputs of a score.

    Raises:
        ScoringInputsUnreadableError: If they are damaged, of another version, or of a task that
            this program does not know.
    """
    try:
        meta, arrays = parted(memoryview(payload))
        if (meta["version"], meta["features"]) != (VERSION, list(NAMES)):
            raise ScoringInputsUnreadableError(
                f"the inputs of the score are of version {meta['version']} with "
                f"{len(meta['features'])} features, and this program scores version {VERSION} with "
                f"{len(NAMES)}: mine the log again"
            )
        return _inputs(meta, arrays)
    except (*_DAMAGED, PackUnreadableError, UnknownTaskError) as error:
        raise ScoringInputsUnreadableError(
            f"the inputs of the score are damaged: {error}: mine the log again"
        ) from error


def _inputs(meta: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> ScoringInputs:
    scene = _scene(meta, arrays)
    instances = _instances(scene, meta["classes"], arrays)
    ends = np.cumsum(arrays["track_lengths"])
    tracks = []
    features = _rows(arrays["track_features"])
    listed = np.split(arrays["track_members"], ends[:-1]) if len(ends) else []
    for indices, row in zip(listed, features, strict=True):
        members = [instances[i] for i in indices]
        track = Track(members[0].kind, tuple(indices.tolist()), centres_in_odom(scene, members))
        size_m = np.median([member.size_m for member in members], axis=0)
        tracks.append(DescribedTrack(track, members, size_m, TrackFeatures(*row.tolist())))
    return ScoringInputs(
        origin=Origin(**meta["origin"]),
        producers=Producers.model_validate(meta["producers"]),
        own_model=str(meta["own_model"]),
        scene=scene,
        statistics=_STATISTICS.validate_python(meta["statistics"]),
        instances=instances,
        tracks=tracks,
    )


def _scene(meta: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Scene:
    task = task_named(meta["task"])
    poses = _rows(arrays["poses"]).reshape(-1, 4, 4)
    log_id = str(meta["origin"]["log_id"])
    columns = (arrays["stamps_ns"].tolist(), arrays["odometry"].tolist(), poses)
    no_labels = FrameLabels(np.zeros(0, np.uint8), np.zeros(0, np.float16))
    frames = tuple(
        LabelledFrame(
            PosedFrame(_empty_frame(log_id, stamp_ns), pose, odometry=_STATES[state]),
            *(no_labels, no_labels, np.zeros(0, np.uint8), task),
        )
        for stamp_ns, state, pose in zip(*columns, strict=True)
    )
    return Scene(str(meta["scene_id"]), frames, too_short=bool(meta["too_short"]))


def _empty_frame(log_id: str, stamp_ns: int) -> LidarFrame:
    return LidarFrame(
        log_id=log_id,
        stamp_ns=stamp_ns,
        points_m=np.zeros((0, 3), np.float32),
        intensity=np.zeros(0, np.float32),
        offset_ns=np.zeros(0, np.int32),
        ring=np.zeros(0, np.int16),
        valid_mask=np.zeros(0, np.bool_),
    )


def _instances(
    scene: Scene, classes: Sequence[str], arrays: dict[str, NDArray[Any]]
) -> tuple[Instance, ...]:
    kinds = scene.task.kinds
    columns = zip(
        arrays["instance_frame"].tolist(),
        arrays["instance_kind"].tolist(),
        arrays["instance_class"].tolist(),
        arrays["instance_points"].tolist(),
        _rows(arrays["instance_values"]),
        strict=True,
    )
    return tuple(
        Instance(
            kind=kinds[kind],
            frame_index=frame,
            point_index=np.zeros(points, np.int64),
            centre_m=row[0:3].copy(),
            size_m=row[3:6].copy(),
            velocity_m_per_s=row[6:9].copy(),
            yaw_rad=float(row[9]),
            semantic_confidence=float(row[10]),
            predictive_confidence=float(row[11]),
            confirmed_share=None if np.isnan(row[12]) else float(row[12]),
            class_name=classes[name],
        )
        for frame, kind, name, points, row in columns
    )


def _values(instance: Instance) -> NDArray[np.float64]:
    """Return what the ranking reads of an instance, in the order of `_instances`."""
    confirmed = instance.confirmed_share
    return np.concatenate(
        (
            instance.centre_m,
            instance.size_m,
            instance.velocity_m_per_s,
            [instance.yaw_rad, instance.semantic_confidence, instance.predictive_confidence],
            [np.nan if confirmed is None else confirmed],
        )
    )


def _planes(rows: Sequence[Any], columns: int) -> NDArray[np.uint8]:
    """Convert rows of floats to (columns, 8, rows) byte planes, which compress best."""
    table = np.array(rows, dtype="<f8").reshape(-1, columns)
    return np.ascontiguousarray(table.view(np.uint8).reshape(-1, columns, 8).transpose(1, 2, 0))


def _rows(planes: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the rows of floats of byte planes."""
    table = np.ascontiguousarray(planes.transpose(2, 0, 1)).view("<f8")[..., 0]
    return table.astype(np.float64)
