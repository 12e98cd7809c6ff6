"""Options and choice of the networks of `train` that learn without truth."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from service.errors import UsageError

if TYPE_CHECKING:
    from workers.lab.training.teach_unlabelled import Task

UNLABELLED: Final = ("gndnet", "flowstep3d", "delora")
"""Networks that need no truth."""

FINE_TUNING: Final = "published-finetune"
"""The second published setting, which FlowStep3D alone has."""

_TEACHER: Final = {
    "gndnet": "it learns the ground found in the clouds",
    "flowstep3d": "it learns from pairs of clouds without labels",
    "delora": "it learns from pairs of scans without labels",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PairOptions:
    """Options of networks that learn from pairs of frames."""

    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            min=64,
            max=1 << 17,
            help="Points drawn of each cloud, flowstep3d; default 4096, published 8192.",
        ),
    ] = None
    image_rows: Annotated[
        int | None,
        typer.Option("--image-rows", min=16, max=1024, help="Rows of delora's image; default 64."),
    ] = None
    image_columns: Annotated[
        int | None,
        typer.Option(
            "--image-columns", min=64, max=8192, help="Columns of delora's image; default 720."
        ),
    ] = None

    def refuse_for(self, network: str) -> None:
        """Refuse options that say nothing of a network.

        Raises:
            UsageError: If one of them was given.
        """
        belongs = {
            "--points": ("flowstep3d", self.points),
            "--image-rows": ("delora", self.image_rows),
            "--image-columns": ("delora", self.image_columns),
        }
        for option, (owner, given) in belongs.items():
            if given is not None and network != owner:
                raise UsageError(f"{option} is an option of {owner}, not of {network}")


def refuse_unused(network: str, given: dict[str, bool]) -> None:
    """Refuse options that say nothing of a network without truth.

    Raises:
        UsageError: If one of them was given.
    """
    if unused := [option for option, is_given in given.items() if is_given]:
        raise UsageError(f"{network} takes no {unused[0]}: {_TEACHER[network]}")


def task_of(network: str, preset: str, epochs: int, pairs: PairOptions) -> "Task[Any, Any, Any]":
    """Return the training of a network without truth."""
    published = preset != "default"
    if network == "gndnet":
        from workers.lab.training.teach_ground import GroundTask

        return GroundTask(published=published, epochs=epochs)
    if network == "flowstep3d":
        from workers.lab.training.teach_flow import FlowTask

        return FlowTask(preset=preset, epochs=epochs, points=pairs.points or 0)
    from workers.lab.training.teach_odometry import OdometryTask

    usual = OdometryTask()
    return OdometryTask(
        published=published,
        epochs=epochs,
        rows=pairs.image_rows or usual.rows,
        columns=pairs.image_columns or usual.columns,
    )
