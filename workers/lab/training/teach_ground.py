"""GndNet as a network that needs no truth: it learns the ground found in clouds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.checkpoints.stored_weights import Stored
from workers.lab.datasets.ground_clouds import (
    LABELS,
    GroundCloud,
    clouds_of_streets,
    clouds_of_stretch,
)
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.training.data import MOST_HELD_OUT, DataSettings
from workers.lab.training.elevation import (
    PUBLISHED_EPOCHS,
    PUBLISHED_EVERY,
    PUBLISHED_TILT_DEG,
    TILT_DEG,
    loss_in_words,
    optimiser_in_words,
    published_settings,
    train_ground,
)
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.gndnet import GndNet
from workers.paper.weights import GndNetCard, load_gndnet


@dataclass(frozen=True, slots=True)
class GroundTask:
    """Training of GndNet, and the maker of its clouds.

    Attributes:
        published: Schedule and augmentation of the publication.
        epochs: Epochs of the published schedule; 0: as published.
    """

    published: bool = False
    epochs: int = 0
    name: str = "gndnet"
    labels: str = LABELS
    what: str = "clouds"
    most_judged: int = MOST_HELD_OUT

    @property
    def maker(self) -> "GroundTask":
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
        every = PUBLISHED_EVERY if self.published else 1
        return clouds_of_stretch(folder, bucket, stretch, mining, every=every, on_frame=on_frame)

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
        """Return of how many frames one is taken."""
        return PUBLISHED_EVERY if settings.published else 1

    def request(self, mining: MiningSettings) -> dict[str, str | int | float]:
        """Return what decides the weights in addition to data and schedule."""
        del mining
        return {"epochs": self.epochs if self.published else 0}

    def items_of(self, files: Sequence[Path]) -> list[Path]:
        """Return the clouds."""
        return list(files)

    def schedule(self, settings: TrainingSettings, *, items: int) -> TrainingSettings:
        """Return the schedule for a number of clouds."""
        if not self.published:
            return settings
        return published_settings(settings, clouds=items, epochs=self.epochs or PUBLISHED_EPOCHS)

    def card(self, items: Sequence[Path], before: GndNetCard | None) -> GndNetCard:
        """Return a card with the height of the sensor."""
        heights_m = [GroundCloud.read(each).sensor_height_m for each in items] if not before else []
        return GndNetCard(
            sensor_height_m=before.sensor_height_m
            if before
            else round(float(np.median(heights_m)), 3),
            attribution="",
            data_license="",
            training={
                "optimiser": optimiser_in_words(published=self.published),
                "loss": loss_in_words(published=self.published),
                "tilt_deg": PUBLISHED_TILT_DEG if self.published else TILT_DEG,
            },
        )

    def train(
        self,
        items: Sequence[Path],
        judged: Mapping[str, Sequence[Path]],
        card: GndNetCard,
        settings: TrainingSettings,
        *,
        out: Path,
        initial: Mapping[str, Tensor] | None,
        state: Path,
        on_step: Callable[[int], None],
    ) -> Progress:
        """Run the schedule."""
        return train_ground(
            items, judged, card, settings, out=out, initial=initial, state=state, on_step=on_step
        )

    def load(self, path: Path) -> Stored[GndNet, GndNetCard]:
        """Load weights of GndNet."""
        return load_gndnet(path)
