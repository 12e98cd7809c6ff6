"""Verbs `adapt` and `train`: weights for a fleet's own lidars, without labels or with truth."""

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from service.cli.daemons import need_bucket
from service.cli.option_groups import grouped
from service.cli.options import MOST, BucketOfLogs, Config, Json, Weights, settings_for
from service.cli.output import command, json_line, progress, remark
from service.cli.truth_options import parse_frames
from service.cli.unlabelled import FINE_TUNING, UNLABELLED, PairOptions, refuse_unused, task_of
from service.errors import UsageError
from service.output_files import need_folder

if TYPE_CHECKING:
    from workers.lab.training.data import DataSettings
    from workers.lab.training.settings import TrainingSettings
    from workers.lab.training.teach import Network, Origin, Taught

Out = Annotated[Path, typer.Option("--out", help="Folder for the weights and their cards.")]
Force = Annotated[bool, typer.Option("--force", help="Replace other weights in that folder.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOptions:
    """Options of the data of a run."""

    frames: Annotated[
        str, typer.Option("--frames", help="Frames A:B of each log; default: spread over it.")
    ] = ""
    images: Annotated[
        int, typer.Option("--images", min=1, max=MOST, help="Frames of all logs together at most.")
    ] = 400
    streets: Annotated[
        int, typer.Option("--streets", min=0, max=MOST, help="Simulated streets to replay.")
    ] = 24
    street_sensor: Annotated[
        list[str] | None,
        typer.Option("--street-sensor", help="Lidar of the streets. Repeatable; default: five."),
    ] = None
    street_columns: Annotated[
        int | None,
        typer.Option("--street-columns", min=64, max=MOST, help="Firings per turn in streets."),
    ] = None
    replay: Annotated[
        list[Path] | None,
        typer.Option("--replay", help="Folder with logs and truth to replay as well. Repeatable."),
    ] = None
    replay_share: Annotated[
        float,
        typer.Option(
            "--replay-share", min=0.0, max=0.95, help="Share of what is learnt that is replayed."
        ),
    ] = 0.4
    attribution: Annotated[
        str, typer.Option("--attribution", help="Source of the logs, for the card.")
    ] = ""
    licence: Annotated[
        str, typer.Option("--licence", help="Licence of the logs, for the card.")
    ] = ""

    def data(self, bucket: str, truth: Path | None, *, seed: int) -> "DataSettings":
        """Return the data of a run.

        Raises:
            UsageError: If frames or a sensor are none.
        """
        from workers.lab.simulation.output.samples import DEFAULT_SENSORS
        from workers.lab.simulation.sensor.sensors import SENSORS, SensorName
        from workers.lab.training.data import DataSettings

        sensors = tuple(self.street_sensor or DEFAULT_SENSORS)
        if unknown := [name for name in sensors if name not in SENSORS]:
            raise UsageError(f"--street-sensor: {unknown[0]!r} is none of {', '.join(SENSORS)}")
        return DataSettings(
            bucket=bucket,
            truth=truth,
            frames=parse_frames(self.frames) if self.frames else None,
            most=self.images,
            streets=self.streets,
            sensors=cast("tuple[SensorName, ...]", sensors),
            columns=self.street_columns,
            replay=tuple(self.replay or ()),
            replay_share=self.replay_share,
            seed=seed,
        )

    def origin(self) -> "Origin":
        """Return what the card says of the command and the logs."""
        from workers.lab.training.teach import Origin

        said = shlex.join([Path(command()).name, *sys.argv[1:]])
        return Origin(said, self.attribution, self.licence)


_RATE = 2e-3
_DELORA_RATE = 1e-4
"""Highest learning rates unless they are named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleOptions:
    """Options of the schedule of a run."""

    steps: Annotated[int, typer.Option("--steps", min=1, max=MOST, help="Steps at most.")] = 600
    batch: Annotated[int, typer.Option("--batch", min=1, max=1024, help="Images a step.")] = 2
    peak_rate: Annotated[
        float | None,
        typer.Option(
            "--peak-rate",
            min=1e-9,
            max=1e9,
            help="Highest learning rate; default 2e-3, delora 1e-4.",
        ),
    ] = None
    patience: Annotated[
        int,
        typer.Option(
            "--patience", min=0, max=MOST, help="Scorings without a better one to stop at; 0: none."
        ),
    ] = 4
    seed: Annotated[int, typer.Option("--seed", min=0, max=MOST, help="Seed of everything.")] = 1
    threads: Annotated[
        int, typer.Option("--threads", min=1, max=256, help="Processor cores to use.")
    ] = 1
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Convolve in bfloat16, where it is faster.")
    ] = False
    device: Annotated[
        str | None, typer.Option("--device", help="auto, cpu or cuda; else COUNTERPOINT_DEVICE.")
    ] = None

    def schedule(self, device: str, network: str = "") -> "TrainingSettings":
        """Return the schedule of a network on a device."""
        from workers.checkpoints.devices import device_of
        from workers.lab.training.settings import TrainingSettings

        return TrainingSettings(
            steps=self.steps,
            batch=self.batch,
            peak_rate=self.peak_rate or (_DELORA_RATE if network == "delora" else _RATE),
            fixed_norms=0.4,
            lovasz_every=4,
            patience=self.patience,
            seed=self.seed,
            threads=self.threads,
            bfloat16=self.bfloat16,
            device=device_of(device),
        )


Restart = Annotated[
    bool, typer.Option("--restart", help="Give up an unfinished training in the folder.")
]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint adapt s3://logs --out weights-of-my-fleet")(grouped(adapt))
    app.command(epilog="counterpoint train lmnet --logs logs --truth truth --out weights")(
        grouped(train)
    )


def adapt(
    bucket: BucketOfLogs,
    out: Out,
    data: DataOptions,
    schedule: ScheduleOptions,
    network: Annotated[
        list[str] | None,
        typer.Option("--network", help="Network to adapt: lmnet, salsanext; default: both."),
    ] = None,
    restart: Restart = False,
    force: Force = False,
    json: Json = False,
    weights: Weights = None,
    config: Config = None,
) -> None:
    """Adapt the networks to logs without a label, by what the self-supervised stream proves.

    The same command goes on after a kill. Such networks are no independent critics of motion.
    """
    settings = settings_for(config, bucket=bucket, weights=weights, device=schedule.device)
    need_bucket(settings)
    from workers.lab.training.teach import NETWORKS, need_free
    from workers.lab.training.teach import adapt as adapt_to
    from workers.supervised.stream import SHIPPED

    networks = [_network(name) for name in dict.fromkeys(network or NETWORKS)]
    need_folder(out, option="--out")
    need_free(out, networks, force=force)
    initial = Path(settings.weights) if settings.weights else SHIPPED
    with _bar() as on_progress:
        taught = adapt_to(
            data.data(settings.bucket, None, seed=schedule.seed),
            settings.mining(),
            schedule.schedule(settings.device),
            initial=initial,
            out=out,
            origin=data.origin(),
            networks=networks,
            restart=restart,
            on_progress=on_progress,
        )
    _say(taught, json=json)
    if not json:
        remark(
            f"mine with --weights {out}: records say that the supervised stream was taught by the "
            "self-supervised stream, and attribute no contradiction to either"
        )


def train(
    network: Annotated[
        str,
        typer.Argument(help="Network to train: lmnet, salsanext, gndnet, flowstep3d, delora."),
    ],
    out: Out,
    data: DataOptions,
    schedule: ScheduleOptions,
    pairs: PairOptions,
    logs: Annotated[str, typer.Option("--logs", help="URL or path of a bucket of logs.")] = "",
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="Folder DIR with the truth of LOGS/x/y.mcap in DIR/x/y."),
    ] = None,
    initial: Annotated[
        Path | None,
        typer.Option("--initial", help="Weights to continue from; default: random ones."),
    ] = None,
    preset: Annotated[
        str,
        typer.Option(
            "--preset",
            help="Schedule and augmentation: default, or published; flowstep3d also "
            "published-finetune.",
        ),
    ] = "default",
    epochs: Annotated[
        int,
        typer.Option("--epochs", min=0, max=MOST, help="Epochs of the preset published."),
    ] = 0,
    classes: Annotated[
        str,
        typer.Option("--classes", help="Classes of salsanext: coarse, semantickitti or own."),
    ] = "coarse",
    width: Annotated[
        int, typer.Option("--width", min=4, max=128, help="Channels of the first stage.")
    ] = 8,
    restart: Restart = False,
    force: Force = False,
    json: Json = False,
    config: Config = None,
) -> None:
    """Train a network on the truth of logs, on simulated streets, or on both.

    GndNet, FlowStep3D and DeLORA need no truth. The same command goes on after a kill.
    """
    settings = settings_for(config, bucket=logs or None, device=schedule.device)
    from workers.lab.datasets.classes import ClassTable
    from workers.lab.training.settings import PRESETS
    from workers.lab.training.teach import need_free, train_network

    if network in UNLABELLED:
        refuse_unused(
            network,
            {
                "--truth": truth is not None,
                "--classes": classes != "coarse",
                "--width": width != 8,
                "--replay": bool(data.replay),
                "--bfloat16": schedule.bfloat16 and network == "flowstep3d",
            },
        )
    name = network if network in UNLABELLED else _network(network, known=_KNOWN)
    pairs.refuse_for(name)
    if name not in UNLABELLED and (not logs) != (truth is None):
        raise UsageError("--logs and --truth belong together: one of them is missing")
    if not logs and not data.streets and not data.replay:
        raise UsageError("there is nothing to learn from: name --logs with --truth, or --streets")
    presets = (*PRESETS, FINE_TUNING) if name == "flowstep3d" else PRESETS
    if preset not in presets:
        raise UsageError(f"--preset: {preset!r} is none of {', '.join(presets)}")
    if classes not in _CLASSES:
        raise UsageError(f"--classes: {classes!r} is none of {', '.join(_CLASSES)}")
    if classes == "own" and truth is None:
        raise UsageError("--classes own reads the classes.json of --truth, which is missing")
    if width % 4:
        raise UsageError(f"--width must be a multiple of 4, got {width}")
    need_folder(out, option="--out")
    need_free(out, [name], force=force)
    table = ClassTable()
    if classes == "own" and truth is not None:
        table = ClassTable.own_of(truth)
    elif classes == "semantickitti":
        table = ClassTable.semantickitti()
    chosen = replace(schedule.schedule(settings.device, name), published=preset != "default")
    if name in UNLABELLED:
        from workers.lab.training.teach_unlabelled import teach

        with _bar() as on_progress:
            unlabelled = teach(
                task_of(name, preset, epochs, pairs),
                data.data(logs, None, seed=schedule.seed),
                settings.mining(),
                chosen,
                out=out,
                origin=data.origin(),
                initial=initial,
                restart=restart,
                on_progress=on_progress,
            )
        _say([unlabelled], json=json)
        return
    with _bar() as on_progress:
        taught = train_network(
            _network(name),
            data.data(logs, truth, seed=schedule.seed),
            settings.mining(),
            chosen,
            out=out,
            origin=data.origin(),
            initial=initial,
            classes=table,
            width=width,
            epochs=epochs,
            restart=restart,
            on_progress=on_progress,
        )
    _say([taught], json=json)


_KNOWN = "lmnet, salsanext, gndnet, flowstep3d, delora"
_CLASSES = ("coarse", "semantickitti", "own")


def _network(name: str, *, known: str = "lmnet, salsanext") -> "Network":
    if name not in ("lmnet", "salsanext"):
        raise UsageError(f"{name!r} is none of the networks that can be trained: {known}")
    return cast("Literal['lmnet', 'salsanext']", name)


@contextmanager
def _bar() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each thing that is done, in the order in which they begin."""
    with progress() as bar:
        tasks: dict[str, Any] = {}

        def on_progress(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield on_progress


def _say(taught: "list[Taught]", *, json: bool) -> None:
    for each in taught:
        done = each.progress
        if json:
            json_line(
                {
                    "network": each.network,
                    "path": str(each.path),
                    "sha256": each.digest,
                    "steps": each.steps,
                    "kept_step": done.best_step,
                    "curve": [
                        {"step": step, "loss": loss, "score": None if score != score else score}
                        for step, loss, score in done.curve
                    ],
                    "scores": done.scores,
                }
            )
            continue
        scores = ", ".join(f"{name} {score:.3f}" for name, score in done.scores.items())
        remark(
            f"{each.network}: {each.steps} steps, kept those of step {done.best_step}; held out: "
            f"{scores or 'nothing'} ({each.path}; sha256 of weights and card {each.digest[:12]})"
        )
