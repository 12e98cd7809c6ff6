"""Fusion of both networks to semantic motion labels: movable and moving points are dynamic."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Confidences, Labels, Mask, MotionLabels
from schemas.labels import FrameLabels, MotionLabel
from schemas.task import MOTION, Task
from workers.supervised.classes import ClassSet


def fuse(*, judged_mask: Mask, movable_mask: Mask, moving_mask: Mask | None) -> MotionLabels:
    """Combine semantics and motion per point.

    The paper's rule (section III-A): a point is dynamic if its class is movable and the motion
    network labels it moving; every other labelled point is static. A house labelled "moving" is an
    error of the motion network, not a dynamic house.

    Without a past frame, the motion network has no evidence. Then a movable point is UNKNOWN, while
    any other stays STATIC, because the motion network could not change that.

    Args:
        judged_mask: (N,) points in the input of the networks.
        movable_mask: (N,) points of a class that can move by itself.
        moving_mask: (N,) points that the motion network labels moving; None without a past frame.

    Returns:
        (N,) labels; UNKNOWN where not judged.
    """
    if moving_mask is None:
        moved = np.where(movable_mask, np.uint8(MotionLabel.UNKNOWN), np.uint8(MotionLabel.STATIC))
    else:
        moved = np.where(
            movable_mask & moving_mask, np.uint8(MotionLabel.DYNAMIC), np.uint8(MotionLabel.STATIC)
        )
    return np.where(judged_mask, moved, np.uint8(MotionLabel.UNKNOWN))


def confidence_of(labels: Labels, second_share: NDArray[np.float32]) -> Confidences:
    """Compute the confidence of each label of a task of two classes.

    Args:
        labels: (N,) labels.
        second_share: (N,) probability of the second class, 0 to 1; for motion the probability of a
            movable class times the probability of moving.

    Returns:
        (N,) float16: that probability for the second class, its complement for the first, 0 for
        unknown points.
    """
    sure = np.where(labels == 1, second_share, 1 - second_share)
    return np.where(labels > 1, 0, np.clip(sure, 0, 1)).astype(np.float16)


class Fusion(Protocol):
    """Combines the probabilities of the networks to labels of a task."""

    @property
    def task(self) -> Task:
        """Task of the labels."""
        ...

    @property
    def kinds(self) -> ClassSet | None:
        """Classes of the semantic network; None without one."""
        ...

    @property
    def motions(self) -> ClassSet | None:
        """Classes of the motion network; None without one."""
        ...

    def labels(
        self,
        *,
        judged_mask: Mask,
        kind: NDArray[np.int16] | None,
        motion: NDArray[np.int16] | None,
        second_share: NDArray[np.float32],
    ) -> FrameLabels:
        """Combine the classes of each point; see `MotionFusion.labels`."""
        ...

    def second_share(
        self, semantic: NDArray[np.float32] | None, motion: NDArray[np.float32] | None
    ) -> NDArray[np.float32]:
        """Return the probability of the task's second class of each pixel or point."""
        ...


@dataclass(frozen=True, slots=True)
class MotionFusion:
    """Motion labels of each point from one or two networks.

    Motion comes from the motion network, or from the semantic one where its classes include motion.
    Without either, movable points are UNKNOWN.

    Attributes:
        kinds: Classes of the semantic network; None without one: everything can move.
        motions: Classes of the motion network; None without one.
    """

    kinds: ClassSet | None
    motions: ClassSet | None
    task: ClassVar[Task] = MOTION

    def labels(
        self,
        *,
        judged_mask: Mask,
        kind: NDArray[np.int16] | None,
        motion: NDArray[np.int16] | None,
        second_share: NDArray[np.float32],
    ) -> FrameLabels:
        """Combine the classes of each point.

        Args:
            judged_mask: (N,) points in the input of the networks.
            kind: (N,) class index of the semantic network; None without one.
            motion: (N,) class index of the motion network; None without one, or without a past.
            second_share: (N,) probability of dynamic, 0 to 1.

        Returns:
            Labels, confidences and classes of the frame.
        """
        movable, moving = np.ones_like(judged_mask), None
        if self.kinds is not None and kind is not None:
            movable = self.kinds.movable[kind]
            if self.motions is None and self.kinds.tells_motion:
                movable = moving = self.kinds.moving[kind]
        if self.motions is not None and motion is not None:
            moving = self.motions.moving[motion]
        labels = fuse(judged_mask=judged_mask, movable_mask=movable, moving_mask=moving)
        return FrameLabels(
            labels=labels,
            confidence=confidence_of(labels, second_share),
            class_id=None if kind is None else np.where(judged_mask, kind, np.int16(-1)),
        )

    def second_share(
        self, semantic: NDArray[np.float32] | None, motion: NDArray[np.float32] | None
    ) -> NDArray[np.float32]:
        """Return the probability of dynamic of each pixel or point.

        Args:
            semantic: (K, ...) probabilities of the semantic network; None without one.
            motion: (L, ...) probabilities of the motion network; None without one.

        Returns:
            (...) probability of a movable class times the probability of moving; one of them if the
            other is not known.
        """
        shares = []
        if self.kinds is not None and semantic is not None:
            by_itself = self.motions is None and self.kinds.tells_motion
            shares.append(semantic[self.kinds.moving if by_itself else self.kinds.movable].sum(0))
        if self.motions is not None and motion is not None:
            shares.append(motion[self.motions.moving].sum(axis=0))
        share: NDArray[np.float32] = shares[0] if len(shares) == 1 else shares[0] * shares[1]
        return share
