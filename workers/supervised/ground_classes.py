"""Ground labels from semantic classes, the task `ground`: some class names mean ground."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Labels, Mask
from schemas.labels import FrameLabels
from schemas.task import GROUND, Task
from workers.checkpoints.errors import WeightsUnusableError
from workers.supervised.classes import ClassSet
from workers.supervised.fusion import confidence_of

OTHER_LABEL: Final = np.uint8(GROUND.classes.index("other"))
GROUND_LABEL: Final = np.uint8(GROUND.classes.index("ground"))
UNKNOWN_LABEL: Final = np.uint8(GROUND.unknown)

GROUND_NAMES: Final = frozenset(
    (
        "driveable_surface",
        "driveway",
        "ground",
        "lane_marking",
        "other_flat",
        "other_ground",
        "parking",
        "rail_track",
        "road",
        "road_marking",
        "sidewalk",
        "terrain",
    )
)
"""Names of ground in SemanticKITTI, KITTI-360, nuScenes, PandaSet and the shipped weights."""

UNTOLD_NAMES: Final = frozenset(("ignored", "unknown", "unlabeled", "unlabelled", "void"))
"""Names of classes without information."""


def ground_labels_of(class_names: Sequence[str]) -> Labels:
    """Return the ground label of each class.

    Returns:
        (K,) labels of the task `ground`; case, spaces, dashes and underscores do not matter.
    """
    plain = [name.strip().lower().replace(" ", "_").replace("-", "_") for name in class_names]
    return np.array(
        [
            UNKNOWN_LABEL
            if name in UNTOLD_NAMES
            else GROUND_LABEL
            if name in GROUND_NAMES
            else OTHER_LABEL
            for name in plain
        ],
        dtype=np.uint8,
    )


@dataclass(frozen=True, slots=True)
class GroundFusion:
    """Ground labels of each point from a semantic network, without a motion network.

    Attributes:
        kinds: Classes of the semantic network.

    Raises:
        WeightsUnusableError: If none of them is ground.
    """

    kinds: ClassSet
    motions: ClassVar[None] = None
    task: ClassVar[Task] = GROUND

    def __post_init__(self) -> None:
        """Check that the network has a ground class."""
        if not self._ground_mask.any():
            names = ", ".join(meaning.name for meaning in self.kinds.classes)
            raise WeightsUnusableError(f"no class of the semantic network is ground: {names}")

    def labels(
        self,
        *,
        judged_mask: Mask,
        kind: NDArray[np.int16] | None,
        motion: NDArray[np.int16] | None,
        second_share: NDArray[np.float32],
    ) -> FrameLabels:
        """Return the ground label of each point by its class.

        Args:
            judged_mask: (N,) points in the input of the network.
            kind: (N,) class index of the semantic network.
            motion: Not used.
            second_share: (N,) probability of ground, 0 to 1.
        """
        if kind is None:
            raise ValueError("ground is told by the semantic network, which said nothing")
        labels = np.append(self._of_class, UNKNOWN_LABEL)[kind]
        labels = np.where(judged_mask, labels, UNKNOWN_LABEL)
        return FrameLabels(
            labels=labels,
            confidence=confidence_of(labels, second_share),
            class_id=np.where(judged_mask, kind, np.int16(-1)),
        )

    def second_share(
        self, semantic: NDArray[np.float32] | None, motion: NDArray[np.float32] | None
    ) -> NDArray[np.float32]:
        """Return the probability of ground of each pixel or point, from (K, ...) probabilities."""
        if semantic is None:
            raise ValueError("ground is told by the semantic network, which said nothing")
        share: NDArray[np.float32] = semantic[self._ground_mask].sum(axis=0)
        return share

    @property
    def _of_class(self) -> Labels:
        return ground_labels_of([meaning.name for meaning in self.kinds.classes])

    @property
    def _ground_mask(self) -> Mask:
        return np.asarray(self._of_class == GROUND_LABEL)
