"""Verb `bench loop`: what labelling chosen scenes gains a model, against other choices."""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from service.cli.options import MOST, Config, Force, Json, settings_for
from service.cli.output import json_line, progress, remark, table
from service.errors import UsageError
from service.output_files import need_folder, need_writable

if TYPE_CHECKING:
    from service.evaluation.loop_figure import LoopFigure


def loop(
    fleet: Annotated[
        Path,
        typer.Argument(help="Folder of a simulated fleet; simulated there if it does not exist."),
    ],
    budgets: Annotated[
        str, typer.Option("--budgets", help="Numbers of labelled scenes, rising.")
    ] = "1,2,4,8,16",
    seed: Annotated[
        list[int] | None,
        typer.Option("--seed", min=0, max=MOST, help="Seed. Repeatable; default: 1, 2 and 3."),
    ] = None,
    logs: Annotated[
        int, typer.Option("--logs", min=2, max=10_000, help="Logs of a fleet that is simulated.")
    ] = 30,
    taught: Annotated[
        int, typer.Option("--taught", min=1, max=10_000, help="Streets of the first model.")
    ] = 24,
    held_out: Annotated[
        int, typer.Option("--held-out", min=2, max=10_000, help="Streets that judge.")
    ] = 24,
    steps: Annotated[
        int, typer.Option("--steps", min=2, max=MOST, help="Steps of the first model.")
    ] = 4000,
    more_steps: Annotated[
        int, typer.Option("--more-steps", min=2, max=MOST, help="Steps with the chosen scenes.")
    ] = 500,
    workers: Annotated[
        int, typer.Option("--workers", min=1, max=256, help="Number of processes.")
    ] = 1,
    kept: Annotated[
        Path | None,
        typer.Option("--kept", help="Folder of results; default: loop in the fleet's folder."),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the curves into this PNG file.")
    ] = None,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Teach a model with blind spots on the scenes that each order chooses, and compare.

    Each trained model is kept: the same command goes on after a kill.
    """
    numbers = parse_budgets(budgets)
    settings = settings_for(config, bucket=str(fleet / "logs"))
    if plot is not None:
        from workers.lab.plots import need_matplotlib

        need_matplotlib()
        need_writable(plot, option="--plot", force=force, endings=(".png",))
    need_folder(fleet, option="FLEET")
    folder = kept or fleet / "loop"
    need_folder(folder, option="--kept")
    from service.evaluation.loop import run_loop
    from service.evaluation.loop_steps import LoopSettings

    with progress() as bar:
        tasks: dict[str, Any] = {}

        def on_progress(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        found = run_loop(
            fleet,
            LoopSettings(logs, taught, held_out, steps, more_steps, numbers),
            settings.mining(),
            seeds=sorted(set(seed or (1, 2, 3))),
            kept=folder,
            processes=workers,
            on_progress=on_progress,
        )
    if json:
        json_line(found)
    else:
        _say(found)
    if plot is not None:
        from service.evaluation.loop_plot import draw_curves

        draw_curves(plot, found)
        remark(f"plot: {plot}")


def parse_budgets(text: str) -> tuple[int, ...]:
    """Read the budgets, such as `1,2,4`.

    Raises:
        UsageError: If they are no rising whole numbers from 1 on.
    """
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    rising = all(low < high for low, high in pairwise(numbers))
    if not numbers or numbers[0] < 1 or numbers[-1] > 10_000 or not rising:
        raise UsageError(f"--budgets must be rising numbers of scenes, such as 1,2,4, got {text!r}")
    return numbers


def _say(found: "LoopFigure") -> None:
    from service.evaluation.loop_figure import ALARMS

    table(
        f"share of moving pixels found on held-out streets, where {ALARMS:.0%} of the static ones "
        f"are called moving; mean of {len(found.seeds)} seeds, {found.fleet_scenes} scenes in the "
        "fleet",
        (
            *("order", "budget", "labelled", "with an unknown class"),
            *("moving", "95 %", "unknown classes", "95 %", "in rain", "95 %"),
        ),
        (
            (
                *(row.order or "none", row.budget, row.scenes, row.with_unknown),
                *(
                    cell
                    for measure in ("moving", "unknown", "rain")
                    for cell in (row.found[measure], _interval(row.interval[measure]))
                ),
            )
            for row in found.rows
        ),
    )
    table(
        "difference to as many random scenes, 95 %",
        ("order", "budget", "moving", "unknown classes", "in rain"),
        (
            (row.order, row.budget, *(_interval(each) for each in row.over_random.values()))
            for row in found.rows
            if row.over_random
        ),
    )
    table(
        "labelled scenes needed for what the random choice reaches with the largest budget",
        ("order", "measure", "of random", "scenes", "share of the budget", "95 %"),
        (
            (
                *(row.order, row.measure, row.target),
                "more than the budget" if row.scenes is None else row.scenes,
                row.share,
                _share_interval(row.share_interval),
            )
            for row in found.reach
        ),
    )

    if found.rows[0].found["moving"] < LEAST_FOUND:
        remark(
            "the first model finds almost nothing that moves, so that no choice means anything: "
            "give it more --steps"
        )


LEAST_FOUND: Final = 0.1
"""Share of moving pixels that the first model finds below which the loop compares noise."""


def _interval(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.3f} to {interval[1]:.3f}"


def _share_interval(interval: tuple[float, float | None] | None) -> str:
    if interval is None:
        return "more than the budget"
    low, high = interval
    return f"{low:.2f} to " + ("more than the budget" if high is None else f"{high:.2f}")
