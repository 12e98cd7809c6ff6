"""FlowStep3D as a network that needs no truth: it learns from pairs of clouds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.checkpoints.stored_weights import Stored
from workers.lab.datasets.flow_clouds import (
    FEWEST_POINTS,
    FlowCloud,
    clouds_of_streets,
    clouds_of_stretch,
)
from workers.lab.datasets.frame_files import Pair, pairs_of
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.training.data import DataSettings
from workers.lab.training.run_state import Progress
from workers.lab.training.scene_flow import (
    DEFAULT_POINTS,
    MOST_JUDGED,
    PUBLISHED,
    PUBLISHED_POINTS,
    published_settings,
    recipe_of,
    train_flow,
)
from workers.lab.training.settings import TrainingSettings
from workers.paper.flowstep3d import FlowStep3D
from workers.paper.weights import FlowStep3DCard, load_flowstep3d

_ITERATES = 5
_NEIGHBOURS = 16
_RADIUS_M = 1.5
"""Estimates of the flow in use, and the compared points with their radius; published."""


@dataclass(frozen=True, slots=True)
class FlowTask:
    """Training of FlowStep3D, and the maker of its clouds.

    Attributes:
        preset: Preset of training: `default`, `published` or `published-finetune`.
        epochs: Epochs of a published schedule; 0: as published.
        points: Points drawn of each cloud; 0: as published, or half of that.
    """

    preset: str = "default"
    epochs: int = 0
    points: int = 0
    name: str = "flowstep3d"
    labels: str = "none: chamfer distance and smoothness of flow, beyond ego-motion by odometry"
    what: str = "pairs"
    most_judged: int = MOST_JUDGED

    @property
    def maker(self) -> "FlowTask":
        """The task makes its files."""
        return self

    def of_stretch(
        self,
        folder: Path,
        bucket: Bucket,
        stretch: Stretch,
        mining: MiningSettings,
        on_frame: Callable[[], None],
    ) -> list[Path]:
        """Write the clouds of a stretch of a log, or list those of an earlier run."""
        return clouds_of_stretch(folder, bucket, stretch, mining, on_frame=on_frame)

    def of_streets(
        self, folder: Path, data: DataSettings, on_window: Callable[[], None]
    ) -> list[Path]:
        """Write the clouds of simulated streets, or list those of an earlier run."""
        return clouds_of_streets(
            folder,
            streets=data.streets,
            sensors=data.sensors,
            seed=data.seed,
            columns=data.columns,
            on_window=on_window,
        )

    def every(self, settings: TrainingSettings) -> int:
        """Take every frame: pairs need consecutive ones."""
        del settings
        return 1

    def request(self, mining: MiningSettings) -> dict[str, str | int | float]:
        """Return what decides the weights in addition to data and schedule."""
        return {
            "preset": self.preset,
            "epochs": self.epochs,
            "points": self.points,
            "odometry": mining.odometry,
        }

    def items_of(self, files: Sequence[Path]) -> list[Pair]:
        """Return the pairs of consecutive clouds that have enough points in reach."""
        return [each for each in pairs_of(files) if _has_enough(each)]

    def schedule(self, settings: TrainingSettings, *, items: int) -> TrainingSettings:
        """Return the schedule for a number of pairs."""
        if self.preset not in PUBLISHED:
            return settings
        epochs = self.epochs or PUBLISHED[self.preset].epochs
        return published_settings(settings, pairs=items, epochs=epochs)

    def card(self, items: Sequence[Pair], before: FlowStep3DCard | None) -> FlowStep3DCard:
        """Return a card with the parameters of the network."""
        del items
        recipe = recipe_of(self.preset)
        usual = PUBLISHED_POINTS if self.preset in PUBLISHED else DEFAULT_POINTS
        return FlowStep3DCard(
            points=self.points or (before.points if before else usual),
            neighbours=before.neighbours if before else _NEIGHBOURS,
            radius_m=before.radius_m if before else _RADIUS_M,
            decay=recipe.decay,
            iterates=_ITERATES,
            attribution="",
            data_license="",
            training={
                "preset": self.preset,
                "optimiser": "Adam",
                "loss": "fine-tuning" if self.preset == "published-finetune" else "pre-training",
                "movers": recipe.movers,
            },
        )

    def train(
        self,
        items: Sequence[Pair],
        judged: Mapping[str, Sequence[Pair]],
        card: FlowStep3DCard,
        settings: TrainingSettings,
        *,
        out: Path,
        initial: Mapping[str, Tensor] | None,
        state: Path,
        on_step: Callable[[int], None],
    ) -> Progress:
        """Run the schedule."""
        return train_flow(
            items,
            judged,
            card,
            recipe_of(self.preset),
            settings,
            out=out,
            initial=initial,
            state=state,
            on_step=on_step,
        )

    def load(self, path: Path) -> Stored[FlowStep3D, FlowStep3DCard]:
        """Load weights of FlowStep3D."""
        return load_flowstep3d(path)


def _has_enough(pair: Pair) -> bool:
    clouds = FlowCloud.read(pair.first).before(FlowCloud.read(pair.second))
    return min(map(len, clouds)) >= FEWEST_POINTS
