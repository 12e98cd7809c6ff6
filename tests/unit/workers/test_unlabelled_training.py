"""Training on a log without truth from end to end: pairs, card, and a run that is refused."""

from pathlib import Path
from typing import Any

import pytest

from schemas.mining import MiningSettings
from workers.lab.simulation.faults.plan import plan_fleet
from workers.lab.simulation.output.fleet import FleetOptions, write_planned
from workers.lab.training.data import DataSettings
from workers.lab.training.errors import ResumeRefusedError, TrainingDataError
from workers.lab.training.settings import TrainingSettings
from workers.lab.training.teach import WORK, Origin
from workers.lab.training.teach_flow import FlowTask
from workers.lab.training.teach_ground import GroundTask
from workers.lab.training.teach_odometry import OdometryTask
from workers.lab.training.teach_unlabelled import teach

SETTINGS = TrainingSettings(steps=2, batch=1, scorings=1, peak_rate=1e-4)
TASKS = [GroundTask(), FlowTask(points=64), OdometryTask(rows=16, columns=64)]
ORIGIN = Origin("counterpoint train", "our fleet", "ours")


class KilledError(Exception):
    """The end of the process after a step."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> str:
    """One simulated log of two seconds, without truth."""
    folder = tmp_path_factory.mktemp("fleet")
    (plan,) = plan_fleet(scenes=1, seed=3, share=0.0, log_s=(2.0, 2.0))
    write_planned(folder, plan, options=FleetOptions(columns=512))
    return str(folder / "logs")


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_a_log_without_truth_teaches_and_the_card_says_so(
    logs: str, tmp_path: Path, task: Any
) -> None:
    mining = MiningSettings(bucket=logs, artifacts="memory://")
    data = DataSettings(bucket=logs, frames=(0, 6), streets=0)

    def train(settings: TrainingSettings, *, kill: bool = False) -> Any:
        def on_progress(what: str, done: int, total: int) -> None:
            del total
            if kill and what == task.name and done == 1:
                raise KilledError

        return teach(
            *(task, data, mining, settings),
            out=tmp_path,
            origin=ORIGIN,
            on_progress=on_progress,
        )

    with pytest.raises(KilledError):
        train(SETTINGS, kill=True)
    other = TrainingSettings(steps=2, batch=1, scorings=1, peak_rate=1e-4, seed=2)
    with pytest.raises(ResumeRefusedError, match=r"differs in seed: .* --restart"):
        train(other)
    taught = train(SETTINGS)
    assert not (tmp_path / WORK).exists()
    assert taught.steps == 2
    stored = task.load(tmp_path / f"{task.name}.safetensors")
    assert stored.digest == taught.digest
    card = stored.card
    assert (card.attribution, card.data_license) == ("our fleet", "ours")
    items = {"clouds": (5, 1), "pairs": (4, 1)}[task.what]
    assert card.training["learnt"] == f"{items[0]} {task.what} of 1 logs"
    assert card.training["held_out"] == f"{items[1]} {task.what}"
    assert card.training["seed"] == 1
    assert str(card.training["curve"]).startswith("2: ")
    assert set(card.scores) == {name for name, _ in taught.progress.scores.items()}
    assert card.scores


def test_frames_that_are_too_few_for_a_pair_are_one_sentence(logs: str, tmp_path: Path) -> None:
    data = DataSettings(bucket=logs, frames=(0, 1), streets=0)
    mining = MiningSettings(bucket=logs, artifacts="memory://")
    with pytest.raises(TrainingDataError, match="no frame gives pairs of enough points"):
        teach(OdometryTask(), data, mining, SETTINGS, out=tmp_path, origin=ORIGIN)


def test_of_streets_alone_the_last_ones_judge(tmp_path: Path) -> None:
    data = DataSettings(bucket="", streets=2, sensors=("hdl32",), columns=180)
    mining = MiningSettings(bucket="memory://", artifacts="memory://")
    settings = TrainingSettings(steps=1, batch=1, scorings=1)
    taught = teach(GroundTask(), data, mining, settings, out=tmp_path, origin=ORIGIN)
    card = GroundTask().load(taught.path).card
    assert (card.training["streets"], card.training["held_out"]) == (
        "7 clouds of 2 streets",
        "1 clouds",
    )
    assert set(card.scores) == {"simulated streets height error m"}
