"""The supervised stream: SalsaNext says what can move, LMNet what moves, together what does."""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Final, Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.frame import OdometryState, PosedFrame
from schemas.labels import FrameLabels
from workers.geometry.range_image import RangeImage, image_channels, project
from workers.supervised.fusion import confidence_of, fuse
from workers.supervised.lmnet import MOVING
from workers.supervised.postprocess import KnnSettings, find_voters
from workers.supervised.residual_image import ResidualHistory
from workers.supervised.salsanext import SalsaNext
from workers.supervised.weights import LoadedWeights, WeightsUnusableError, load_weights

SHIPPED: Final = Path(__file__).parent / "weights"
"""Folder of the weights that come with the package; its MODEL_CARD.md says what they are."""

_REVISION: Final = "1"
"""Rises when the same weights and settings give other answers."""


class SalsaNextLmnet:
    """Both networks over one range image, fused to semantic motion labels.

    Points outside the vertical field of view of the weights' profile, and invalid ones, are
    UNKNOWN.

    Args:
        semantic: Weights of SalsaNext.
        motion: Weights of LMNet, for the same range image.
        knn: How labels return from pixels to points.

    Raises:
        WeightsUnusableError: If the two do not belong together.
    """

    def __init__(
        self, semantic: LoadedWeights, motion: LoadedWeights, *, knn: KnnSettings | None = None
    ) -> None:
        residual = motion.card.residual
        if semantic.card.network != "salsanext" or motion.card.network != "lmnet":
            raise WeightsUnusableError(
                "the supervised stream needs weights of salsanext and of lmnet, "
                f"got {semantic.card.network} and {motion.card.network}"
            )
        if residual is None or semantic.card.profile != motion.card.profile:
            raise WeightsUnusableError(
                "weights of salsanext and lmnet were made for different range images; "
                "train both with one sensor profile"
            )
        self._semantic, self._motion = semantic, motion
        self._profile, self._residual = semantic.card.profile, residual
        self._knn = knn or KnnSettings()
        self._movable = np.array([meaning.movable for meaning in semantic.card.classes])

    @classmethod
    def shipped(cls) -> Self:
        """Build the stream from the weights that come with the package.

        Raises:
            WeightsUnusableError: If they are missing or damaged.
        """
        return cls(
            load_weights(SHIPPED / "salsanext.safetensors"),
            load_weights(SHIPPED / "lmnet.safetensors"),
        )

    @property
    def version(self) -> str:
        """`name@digest` of code revision, weights with their settings, and post-processing."""
        parts = (_REVISION, self._semantic.digest, self._motion.digest, str(astuple(self._knn)))
        return f"salsanext-lmnet@{hashlib.sha256(' '.join(parts).encode()).hexdigest()[:12]}"

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names that `FrameLabels.class_id` indexes."""
        return tuple(meaning.name for meaning in self._semantic.card.classes)

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order; the past begins anew with every call.

        A frame whose pose is lost empties the past: residuals against it would show the error of
        the pose, not motion.
        """
        torch.set_num_threads(1)  # a worker owns one core, and sums keep their order
        past = ResidualHistory(self._profile, self._residual)
        for posed in frames:
            if posed.odometry is OdometryState.LOST:
                past = ResidualHistory(self._profile, self._residual)
            yield self._label(posed, past)

    def _label(self, posed: PosedFrame, past: ResidualHistory) -> FrameLabels:
        frame = posed.frame
        image = project(frame.points_m, self._profile, valid_mask=frame.valid_mask)
        channels = image_channels(image, frame.points_m, frame.intensity, self._profile)
        residuals, ages = past.residuals(
            image, stamp_ns=frame.stamp_ns, odom_from_sensor=posed.odom_from_sensor
        )
        visible = image.index[image.index >= 0]
        past.push(
            frame.points_m[visible],
            stamp_ns=frame.stamp_ns,
            odom_from_sensor=posed.odom_from_sensor,
        )
        semantic = _probabilities(self._semantic.net, channels)
        motion = _probabilities(self._motion.net, np.concatenate((channels, residuals)))
        return self._fused(image, semantic, motion, has_past=ages > 0)

    def _fused(
        self,
        image: RangeImage,
        semantic: NDArray[np.float32],
        motion: NDArray[np.float32],
        *,
        has_past: bool,
    ) -> FrameLabels:
        """Bring both answers from pixels to points and combine them."""
        class_image, motion_image = _best_class(semantic), _best_class(motion)
        voters = find_voters(image, (class_image, motion_image), self._knn)
        classes = voters.vote(class_image)
        labels = fuse(
            judged_mask=image.projected_mask,
            movable_mask=self._movable[classes],
            moving_mask=voters.vote(motion_image) == MOVING if has_past else None,
        )
        dynamic_share = semantic[self._movable].sum(axis=0) * motion[MOVING]
        return FrameLabels(
            labels=labels,
            confidence=confidence_of(labels, voters.average(dynamic_share)),
            class_id=np.where(image.projected_mask, classes.astype(np.int16), np.int16(-1)),
        )


def _probabilities(net: SalsaNext, channels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Run a network over one image: (C, H, W) in, (classes, H, W) out."""
    x = torch.from_numpy(channels)[None].contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        answer: NDArray[np.float32] = net(x)[0].contiguous().numpy()
    return answer


def _best_class(probabilities: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Likeliest class of each pixel; class 0, "unlabelled", was never taught and never wins."""
    best: NDArray[np.uint8] = (probabilities[1:].argmax(axis=0) + 1).astype(np.uint8)
    return best
