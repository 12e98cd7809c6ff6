"""Pre-labels of points: what a labelling tool shows before a person has labelled anything.

Where both streams agree, that is the label. Where they contradict each other, it is the label of
the stream that the track's attribution finds right, else of the supervised one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.attribution import Wrong
from schemas.excerpt import SceneCloud
from schemas.frame import JoinedLidar
from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.task import Task
from service.export.classes import semantickitti_ids

_SEMANTIC, _PREDICTIVE, _NEITHER = range(3)
_RULES: Final[Mapping[Wrong | None, int]] = {Wrong.SUPERVISED: _PREDICTIVE, Wrong.BOTH: _NEITHER}
"""The label of a contradicting point by its track's attribution: of the supervised stream, of the
self-supervised one, or the opposite of both."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledCloud:
    """The returns of one frame with their pre-labels; points without a return are left out.

    With N points in the message and M returns:

    Attributes:
        number: Index of the frame in the scene.
        stamp_ns: Of the frame, nanoseconds since the Unix epoch.
        frame_id: Space of the points, by the log's own name.
        raw_points: N, of all lidars.
        raw_index: (M,) place of each point in the message, rising; those of further lidars count
            on from the last point of the message before.
        points_m: (M, 3) sensor space, metres.
        intensity: (M,) 0 to 1.
        ring: (M,) beam; -1 where the log has none.
        category: (M,) codes of the task's outcomes.
        track: (M,) track of the record or beyond, -1 none.
        score: (M,) strength of that track, 0 without one.
        label: (M,) class of SemanticKITTI, moving classes included.
        odom_from_sensor: (4, 4) pose.
        lidars: Further lidars whose points follow those of the main one in the N points.
    """

    number: int
    stamp_ns: int
    frame_id: str
    raw_points: int
    raw_index: NDArray[np.uint32]
    points_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.int16]
    category: NDArray[np.uint8]
    track: NDArray[np.int32]
    score: NDArray[np.float32]
    label: NDArray[np.uint32]
    odom_from_sensor: NDArray[np.float64]
    lidars: tuple[JoinedLidar, ...] = ()

    def __len__(self) -> int:
        """Count the returns."""
        return len(self.raw_index)


class PointLabels:
    """Pre-labels of the points of one scene."""

    def __init__(self, overlay: Overlay, score: SceneScore) -> None:
        """Prepare tables from instances to labels; nothing is computed per point."""
        self._overlay = overlay
        tracks = {each.track_id: each for each in score.tracks}
        of = overlay.instance_track.tolist()
        strengths = [tracks[each].strength if each in tracks else 0.0 for each in of]
        wrong = [
            None if each not in tracks or (told := tracks[each].attribution) is None else told.wrong
            for each in of
        ]
        self._track = np.array([*of, -1], dtype=np.int32)
        self._strength = np.array([*strengths, 0.0], dtype=np.float32)
        self._rule = np.array([_RULES.get(each, _SEMANTIC) for each in [*wrong, None]])
        self._semantic, self._predictive = moving_by_outcome(overlay.task)
        self._still_id, self._moving_id = semantickitti_ids(overlay.class_names)

    def of(self, cloud: SceneCloud) -> LabelledCloud:
        """Return the returns of a frame with their pre-labels."""
        overlay, frame = self._overlay, cloud.frame
        points = overlay.points_of(cloud.number)
        raw_index = np.flatnonzero(frame.valid_mask)
        instance = overlay.instance_index[points][raw_index]
        category = overlay.agreements[points][raw_index]
        class_id = overlay.class_id[points][raw_index]
        moving = self._moving(category, instance)
        label = np.where(moving, self._moving_id[class_id], self._still_id[class_id])
        return LabelledCloud(
            number=cloud.number,
            stamp_ns=int(overlay.stamps_ns[cloud.number]),
            frame_id=cloud.frame_id,
            raw_points=len(frame),
            raw_index=raw_index.astype(np.uint32),
            points_m=frame.points_m[raw_index],
            intensity=frame.intensity[raw_index],
            ring=frame.ring[raw_index],
            category=category,
            track=self._track[instance],
            score=self._strength[instance],
            label=label.astype(np.uint32),
            odom_from_sensor=overlay.odom_from_sensor[cloud.number],
            lidars=frame.joined,
        )

    @cached_property
    def moving_instances(self) -> NDArray[np.bool_]:
        """Return (I,) if each instance of the overlay moves, by the rule of its points."""
        kinds = self._overlay.instance_kind
        return self._moving(kinds, np.arange(len(kinds), dtype=np.int32))

    def _moving(
        self, category: NDArray[np.uint8], instance: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        semantic, rule = self._semantic[category], self._rule[instance]
        moving = np.where(rule == _PREDICTIVE, self._predictive[category], semantic)
        return np.where(rule == _NEITHER, ~semantic, moving)


def moving_by_outcome(task: Task) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return by the code of an outcome if each stream labels the point moving."""
    semantic = [bool(task.moving) and each.semantic == task.moving for each in task.outcomes]
    predictive = [bool(task.moving) and each.predictive == task.moving for each in task.outcomes]
    return np.array(semantic), np.array(predictive)
