"""A run of training: killed and resumed, stopped, refused, and what its card says."""

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.unit.workers.test_training import CARD, RESIDUAL, images_of_a_wall
from workers.lab.datasets.classes import meanings
from workers.lab.datasets.stored_images import read_images, write_images
from workers.lab.training import loop
from workers.lab.training.batches import TrainingSet
from workers.lab.training.errors import (
    ResumeRefusedError,
    StateUnwritableError,
    TrainingDivergedError,
)
from workers.lab.training.run_state import open_request, read_state, write_whole
from workers.lab.training.segmentation import published_rate, train
from workers.lab.training.settings import TrainingSettings, published_settings
from workers.lab.training.teach import disk_sentences
from workers.supervised.weights import WeightsCard, load_weights, save_weights

SEMANTIC = CARD.model_copy(
    update={"network": "salsanext", "classes": meanings("salsanext"), "residual": None}
)
SETTINGS = TrainingSettings(steps=6, columns=32, scorings=3, fixed_norms=0.4, dropout=0.2)


class KilledError(Exception):
    """Stands for the end of the process after a step."""


def _sets(*, proved: bool) -> list[TrainingSet]:
    images = images_of_a_wall()
    told = TrainingSet(images, 1.0)
    if not proved:
        return [told]
    known = replace(
        images, semantic=np.where(images.motion == 2, 2, images.motion).astype(np.uint8)
    )
    return [told, TrainingSet(known, 1.0, proved=True)]


def _initial(folder: Path, card: WeightsCard) -> Path:
    torch.manual_seed(3)
    save_weights(folder / "initial.safetensors", card.build(), card)
    return folder / "initial.safetensors"


@pytest.mark.parametrize(("card", "proved"), [(CARD, False), (SEMANTIC, True)])
@pytest.mark.parametrize("at", [1, 3, 6])
def test_killed_after_any_step_and_resumed_a_run_gives_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, card: WeightsCard, proved: bool, at: int
) -> None:
    monkeypatch.setattr(loop, "STATE_EVERY_S", 0.0)
    initial = load_weights(_initial(tmp_path, card))
    judged = {"wall": _sets(proved=proved)[-1]}

    def run(out: Path, *, kill_at: int = -1) -> bytes:
        def on_step(step: int) -> None:
            if step == kill_at:
                raise KilledError

        train(
            *(_sets(proved=proved), judged, card, SETTINGS),
            out=out,
            initial=initial,
            state=out.with_suffix(".state"),
            on_step=on_step,
        )
        return out.read_bytes() + out.with_suffix(".json").read_bytes()

    undisturbed = run(tmp_path / "whole" / "w.safetensors")
    with pytest.raises(KilledError):
        run(tmp_path / "killed" / "w.safetensors", kill_at=at)
    torch.manual_seed(99)
    assert run(tmp_path / "killed" / "w.safetensors") == undisturbed


def test_a_loss_that_is_not_a_number_keeps_the_last_good_weights(tmp_path: Path) -> None:
    out = tmp_path / "w.safetensors"
    images = images_of_a_wall()
    broken = replace(images, channels=images.channels.copy())
    settings = replace(SETTINGS, driving_weight=1.0, steps=40, scorings=40)

    def on_step(step: int) -> None:
        if step == 2:
            broken.channels[:] = np.nan

    with pytest.raises(TrainingDivergedError, match="the weights of step 2 were kept"):
        train([TrainingSet(broken, 1.0)], {}, CARD, settings, out=out, on_step=on_step)
    assert all(torch.isfinite(each).all() for each in load_weights(out).net.state_dict().values())


def test_a_run_stops_when_the_held_out_score_stays_and_keeps_its_best(tmp_path: Path) -> None:
    out = tmp_path / "w.safetensors"
    empty = images_of_a_wall()
    nothing = replace(empty, motion=np.zeros_like(empty.motion))
    settings = replace(SETTINGS, steps=10, scorings=10, patience=2)
    judged = {"all unknown": TrainingSet(nothing, 1.0), "wall": TrainingSet(empty, 1.0)}
    # a peak rate of almost nothing leaves the score of the first scoring
    done = train(
        *([TrainingSet(empty, 1.0)], judged, CARD, replace(settings, peak_rate=1e-12)), out=out
    )
    assert done.step < settings.steps
    assert load_weights(out).card.training["step"] == done.best_step


def test_an_unfinished_run_goes_on_with_the_same_data_alone(tmp_path: Path) -> None:
    request = {"logs": {"a": "1"}, "seed": 1}
    assert not open_request(tmp_path / "work", request, restart=False)
    assert open_request(tmp_path / "work", request, restart=False)
    with pytest.raises(ResumeRefusedError, match=r"differs in logs: .* --restart"):
        open_request(tmp_path / "work", {"logs": {"b": "1"}, "seed": 1}, restart=False)
    assert not open_request(tmp_path / "work", {"seed": 2}, restart=True)


def test_a_damaged_state_is_refused_and_code_in_it_is_not_run(tmp_path: Path) -> None:
    net = torch.nn.Linear(1, 1)
    optimiser = torch.optim.SGD(net.parameters(), lr=1.0)
    schedule = torch.optim.lr_scheduler.ConstantLR(optimiser)
    state = tmp_path / "lmnet.state"
    torch.save({"net": {}, "progress": KilledError()}, state)
    with pytest.raises(ResumeRefusedError, match="--restart"):
        read_state(
            state, net=net, optimiser=optimiser, schedule=schedule, rng=np.random.default_rng()
        )


def test_a_state_that_does_not_fit_on_the_disk_leaves_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "lmnet.state"
    write_whole(path, b"before")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with pytest.raises(StateUnwritableError, match="give the same command again"):
            write_whole(path, b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == b"before"
    assert [each.name for each in tmp_path.iterdir()] == ["lmnet.state"]


def test_images_that_do_not_fit_on_the_disk_are_one_sentence(tmp_path: Path) -> None:
    images = images_of_a_wall()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with (
            pytest.raises(StateUnwritableError, match=r"cannot write the images .*; free space"),
            disk_sentences(tmp_path),
        ):
            write_images(tmp_path / "images", images, source={})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    write_images(tmp_path / "images", images, source={"of": "a wall"})
    again, source = read_images(tmp_path / "images")
    assert source == {"of": "a wall"}
    assert np.array_equal(again.residuals, images.residuals)
    assert np.array_equal(again.motion, images.motion)


def test_what_is_proved_teaches_which_classes_can_move(tmp_path: Path) -> None:
    """Pixels proved to move get probability in the movable classes, the others lose it."""
    initial = load_weights(_initial(tmp_path, SEMANTIC))
    sets = [_sets(proved=True)[1]]
    settings = replace(SETTINGS, steps=40, peak_rate=1e-2, columns=64, fixed_norms=0.0, dropout=0)
    out = tmp_path / "w.safetensors"
    done = train(sets, {"wall": sets[0]}, SEMANTIC, settings, out=out, initial=initial)
    losses = [loss for _, loss, _ in done.curve]
    assert losses[-1] < 0.9 * losses[0]
    assert set(done.scores) == {"wall movable"}


def test_the_published_schedule_warms_up_and_then_loses_a_hundredth_with_each_epoch() -> None:
    rates = [published_rate(step, epoch=10) for step in (0, 9, 10, 20)]
    assert rates == pytest.approx([0.1, 1.0, 1.0, 0.99])
    settings = published_settings(SETTINGS, images=100, epochs=150)
    assert (settings.batch, settings.epoch, settings.steps) == (24, 5, 750)
    assert (settings.peak_rate, settings.weight_decay, settings.dropout) == (0.01, 1e-4, 0.2)


def test_the_published_training_runs_on_whole_images(tmp_path: Path) -> None:
    images = images_of_a_wall()
    layout = CARD.profile
    settings = published_settings(replace(SETTINGS, scorings=1), images=4, epochs=1)
    out = tmp_path / "w.safetensors"
    train([TrainingSet(images, 1.0, layout=layout)], {}, CARD, settings, out=out)
    assert load_weights(out).card.residual == RESIDUAL
