"""Supervised stream: fuses a semantic and a motion network over a range image to motion labels."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.frame import OdometryState, PosedFrame
from schemas.labels import FrameLabels
from schemas.score import TAUGHT
from schemas.task import GROUND, MOTION, Task
from workers.checkpoints.devices import Device
from workers.checkpoints.errors import WeightsUnusableError
from workers.lidar.fidelity import Form
from workers.lidar.range_image import CHANNELS, RangeImage, SensorProfile, image_channels, project
from workers.lidar.sensor_rows import lay_out
from workers.supervised.classes import ClassSet
from workers.supervised.fusion import Fusion, MotionFusion
from workers.supervised.ground_classes import GroundFusion
from workers.supervised.networks import FRAMES_TOGETHER, RangeImageNetwork, answers_of
from workers.supervised.paper_residuals import PaperResiduals
from workers.supervised.postprocess import KnnSettings, find_voters
from workers.supervised.residual_image import Past, ResidualHistory, with_residuals
from workers.supervised.weights import load_weights

SHIPPED: Final = Path(__file__).parent / "weights"
"""Folder of the weights in the package; its MODEL_CARD.md describes them."""

_REVISION: Final = "2"
"""Revision of the code; increases when the same weights and settings give other labels."""


@dataclass(frozen=True, slots=True, eq=False)
class _Projected:
    """A frame as the input of the networks.

    Attributes:
        image: Its projection.
        inputs: (C, H, W) input of each network.
        has_past: Whether residuals compare it with an earlier frame.
    """

    image: RangeImage
    inputs: tuple[NDArray[np.float32], ...]
    has_past: bool


class RangeImageStream:
    """Networks over one range image, fused to semantic motion labels.

    Points outside the vertical field of view of the networks' profile, and invalid ones, are
    UNKNOWN.

    Args:
        semantic: Network of semantic classes; None if only motion is known.
        motion: Network of motion, for the same range image; None if the semantic classes include
            motion, or motion is not known.
        name: Name of the stream in versions.
        form: Form of image, residuals and votes; see `project`, `PaperResiduals` and `KnnSettings`.
        task: Motion, or ground, which needs the semantic network alone.
        together: Frames that the networks run over at once; the labels of a frame wait for them.

    Raises:
        WeightsUnusableError: If there is no network, or the two do not fit together.
    """

    def __init__(
        self,
        semantic: RangeImageNetwork | None,
        motion: RangeImageNetwork | None,
        *,
        name: str,
        form: Form = Form.CORRECTED,
        task: Task = MOTION,
        together: int = 1,
    ) -> None:
        self._together = together
        self._networks = [network for network in (semantic, motion) if network is not None]
        if not self._networks:
            raise WeightsUnusableError("the supervised stream needs a semantic or a motion network")
        self._profile = self._networks[0].profile
        if any(network.profile.layout != self._profile.layout for network in self._networks):
            raise WeightsUnusableError(
                "the semantic and the motion network were made for different range images; "
                "train both with one layout of rows, columns and field of view"
            )
        self._classes = [ClassSet(network.classes) for network in self._networks]
        self._fusion = _fusion_of(
            task,
            kinds=None if semantic is None else self._classes[0],
            motions=None if motion is None else self._classes[-1],
        )
        if self._fusion.motions is not None and not self._fusion.motions.tells_motion:
            raise WeightsUnusableError("no class of the motion network is one that moves")
        self._name, self._form, self._knn = name, form, KnnSettings(form=form)

    @classmethod
    def salsanext_lmnet(
        cls, folder: Path, *, form: Form = Form.CORRECTED, device: Device = "cpu"
    ) -> Self:
        """Build the stream from `salsanext.safetensors` and `lmnet.safetensors` of a folder.

        Args:
            folder: Folder of weights, imported or trained.
            form: Form of image, residuals and votes; the paper's form also runs networks layer by
                layer.
            device: Device of the networks.

        Raises:
            WeightsUnusableError: If one is missing, damaged, or belongs to another network.
        """
        folded = form is Form.CORRECTED
        semantic = load_weights(folder / "salsanext.safetensors", folded=folded, device=device)
        motion = load_weights(folder / "lmnet.safetensors", folded=folded, device=device)
        if semantic.card.network != "salsanext" or motion.card.network != "lmnet":
            raise WeightsUnusableError(
                "the supervised stream needs weights of salsanext and of lmnet, "
                f"got {semantic.card.network} and {motion.card.network} ({folder})"
            )
        taught = TAUGHT if semantic.card.teacher or motion.card.teacher else ""
        name = f"salsanext-lmnet{taught}"
        return cls(semantic, motion, name=name, form=form, together=FRAMES_TOGETHER[device])

    @classmethod
    def salsanext_ground(cls, folder: Path, *, device: Device = "cpu") -> Self:
        """Build the ground stream from `salsanext.safetensors` of a folder.

        Raises:
            WeightsUnusableError: If it is missing, damaged, or no class of it is ground.
        """
        semantic = load_weights(folder / "salsanext.safetensors", folded=True, device=device)
        taught = TAUGHT if semantic.card.teacher else ""
        name = f"salsanext:ground{taught}"
        return cls(semantic, None, name=name, task=GROUND, together=FRAMES_TOGETHER[device])

    @property
    def task(self) -> Task:
        """Task of its labels."""
        return self._fusion.task

    @property
    def version(self) -> str:
        """`name@digest` of code revision, networks with their settings, and post-processing."""
        digests = (network.digest for network in self._networks)
        parts = (_REVISION, *digests, str(astuple(self._knn)))
        return f"{self._name}@{hashlib.sha256(' '.join(parts).encode()).hexdigest()[:12]}"

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names that `FrameLabels.class_id` indexes; none where only motion is known."""
        kinds = self._fusion.kinds
        return () if kinds is None else tuple(meaning.name for meaning in kinds.classes)

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order; every call starts with an empty past.

        A frame whose pose is lost empties the past: residuals against it would show the error of
        the pose, not motion.
        """
        torch.set_num_threads(1)  # a worker owns one core, and sums keep their order
        layout = self._profile
        pasts = self._pasts(layout)
        waiting: list[_Projected] = []
        for posed in frames:
            if layout.fitted:
                yield from self._labels(waiting)  # images of one layout run together
                waiting = []
                layout = lay_out(layout, posed.frame)
                pasts = self._pasts(layout)
            if posed.odometry is OdometryState.LOST:
                pasts = self._pasts(layout)
            waiting.append(self._project(posed, layout, pasts))
            if len(waiting) == self._together:
                yield from self._labels(waiting)
                waiting = []
        yield from self._labels(waiting)

    def _pasts(self, layout: SensorProfile) -> list[Past | None]:
        history = PaperResiduals if self._form is Form.PAPER else ResidualHistory
        return [
            history(layout, network.residual) if network.residual else None
            for network in self._networks
        ]

    def _project(
        self, posed: PosedFrame, layout: SensorProfile, pasts: Sequence[Past | None]
    ) -> _Projected:
        frame = posed.frame
        image = project(frame.points_m, layout, valid_mask=frame.valid_mask, form=self._form)
        measured = {
            profile: image_channels(image, frame.points_m, frame.intensity, profile)
            for profile in {network.profile: None for network in self._networks}
        }
        inputs, ages = [], 1
        for network, past in zip(self._networks, pasts, strict=True):
            channels = _chosen(measured[network.profile], network.channels)
            if past is not None:
                residuals, ages = past.compare(posed, image)
                channels = with_residuals(image, channels, residuals)
            inputs.append(channels)
        return _Projected(image, tuple(inputs), has_past=ages > 0)

    def _labels(self, frames: Sequence[_Projected]) -> Iterator[FrameLabels]:
        """Run each network over all the frames at once, then fuse the answers of each frame."""
        if not frames:
            return
        answers = [
            answers_of(network, [frame.inputs[number] for frame in frames])
            for number, network in enumerate(self._networks)
        ]
        for frame, *answered in zip(frames, *answers, strict=True):
            yield self._fused(frame.image, answered, has_past=frame.has_past)

    def _fused(
        self, image: RangeImage, answers: Sequence[NDArray[np.float32]], *, has_past: bool
    ) -> FrameLabels:
        """Back-project the network outputs from pixels to points, and combine them."""
        codes = [kinds.best(answer) for kinds, answer in zip(self._classes, answers, strict=True)]
        voters = find_voters(image, codes, self._knn)
        points = [
            kinds.class_of(voters.vote(code))
            for kinds, code in zip(self._classes, codes, strict=True)
        ]
        fusion = self._fusion
        semantic = answers[0] if fusion.kinds is not None else None
        motion = answers[-1] if fusion.motions is not None else None
        return fusion.labels(
            judged_mask=image.projected_mask,
            kind=points[0] if fusion.kinds is not None else None,
            motion=points[-1] if fusion.motions is not None and has_past else None,
            second_share=voters.average(fusion.second_share(semantic, motion)),
        )


def _fusion_of(task: Task, *, kinds: ClassSet | None, motions: ClassSet | None) -> Fusion:
    if task == MOTION:
        return MotionFusion(kinds, motions)
    if task == GROUND and kinds is not None and motions is None:
        return GroundFusion(kinds)
    raise WeightsUnusableError(f"these networks do not answer the task {task.name}")


def _chosen(measured: NDArray[np.float32], channels: tuple[str, ...]) -> NDArray[np.float32]:
    """Select a network's channels from (5, H, W) of `CHANNELS`; no copy if it takes all."""
    if channels == CHANNELS:
        return measured
    return measured[[CHANNELS.index(channel) for channel in channels]]
