"""DeLORA as a network that needs no truth: it learns from pairs of scans."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from torch import Tensor

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.checkpoints.stored_weights import Stored
from workers.lab.datasets.frame_files import Pair, pairs_of
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.datasets.normal_scans import (
    COLUMNS,
    PUBLISHED_COLUMNS,
    NormalScan,
    scans_of_streets,
    scans_of_stretch,
)
from workers.lab.training.data import DataSettings
from workers.lab.training.odometry import (
    MOST_JUDGED,
    PUBLISHED_EPOCHS,
    PUBLISHED_FOV_DEG,
    PUBLISHED_SIZE,
    REFINEMENTS,
    published_settings,
    train_odometry,
)
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.delora import DeLORA
from workers.paper.weights import DeLORACard, load_delora

_ROWS, _COLUMNS = PUBLISHED_SIZE

LOSSES: Final = {
    True: "point-to-plane and plane-to-plane distance, the identity in the first epoch",
    False: "error of a motion added to the second scan after the odometry's",
}
"""The loss in words, by whether it is the published one."""


@dataclass(frozen=True, slots=True)
class OdometryTask:
    """Training of DeLORA, and the maker of its scans.

    Attributes:
        published: Schedule and field of view of the publication, and no augmentation.
        epochs: Epochs of the published schedule; 0: `PUBLISHED_EPOCHS`.
        rows: Rows of the network's image.
        columns: Its columns.
    """

    published: bool = False
    epochs: int = 0
    rows: int = _ROWS
    columns: int = _COLUMNS
    name: str = "delora"
    labels: str = "none: distance of two scans, or motion added to poses by odometry"
    what: str = "pairs"
    most_judged: int = MOST_JUDGED

    @property
    def maker(self) -> "OdometryTask":
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
        """Write the scans of a stretch of a log, or list those of an earlier run."""
        columns = PUBLISHED_COLUMNS if self.published else COLUMNS
        return scans_of_stretch(
            *(folder, bucket, stretch, mining),
            columns=columns,
            posed=not self.published,
            on_frame=on_frame,
        )

    def of_streets(
        self, folder: Path, data: DataSettings, on_window: Callable[[], None]
    ) -> list[Path]:
        """Write the scans of simulated streets, or list those of an earlier run."""
        return scans_of_streets(
            folder,
            streets=data.streets,
            sensors=data.sensors,
            seed=data.seed,
            columns=PUBLISHED_COLUMNS if self.published else COLUMNS,
            firings=data.columns,
            on_window=on_window,
        )

    def every(self, settings: TrainingSettings) -> int:
        """Take every frame: pairs need consecutive ones."""
        del settings
        return 1

    def request(self, mining: MiningSettings) -> dict[str, str | int | float]:
        """Return what decides the weights in addition to data and schedule."""
        return {
            "epochs": self.epochs,
            "rows": self.rows,
            "columns": self.columns,
            "odometry": "" if self.published else mining.odometry,
        }

    def items_of(self, files: Sequence[Path]) -> list[Pair]:
        """Return the pairs of consecutive scans."""
        return pairs_of(files)

    def schedule(self, settings: TrainingSettings, *, items: int) -> TrainingSettings:
        """Return the schedule for a number of pairs."""
        if not self.published:
            return settings
        return published_settings(settings, pairs=items, epochs=self.epochs or PUBLISHED_EPOCHS)

    def card(self, items: Sequence[Pair], before: DeLORACard | None) -> DeLORACard:
        """Return a card with the layout of the image; its field of view holds that of all scans."""
        if before is not None:
            rows, columns = before.rows, before.columns
            up, down = before.fov_up_deg, before.fov_down_deg
        else:
            rows, columns = self.rows, self.columns
            views = (
                [] if self.published else [NormalScan.read(each.first).fov_deg for each in items]
            )
            up, down = PUBLISHED_FOV_DEG
            if views:
                up, down = max(each[0] for each in views), min(each[1] for each in views)
        return DeLORACard(
            rows=rows,
            columns=columns,
            fov_up_deg=up,
            fov_down_deg=down,
            refinements=0 if self.published else REFINEMENTS,
            attribution="",
            data_license="",
            training={
                "optimiser": "Adam",
                "loss": LOSSES[self.published],
            },
        )

    def train(
        self,
        items: Sequence[Pair],
        judged: Mapping[str, Sequence[Pair]],
        card: DeLORACard,
        settings: TrainingSettings,
        *,
        out: Path,
        initial: Mapping[str, Tensor] | None,
        state: Path,
        on_step: Callable[[int], None],
    ) -> Progress:
        """Run the schedule."""
        return train_odometry(
            items, judged, card, settings, out=out, initial=initial, state=state, on_step=on_step
        )

    def load(self, path: Path) -> Stored[DeLORA, DeLORACard]:
        """Load weights of DeLORA."""
        return load_delora(path)
