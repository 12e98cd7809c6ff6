from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from schemas.mining import MiningSettings
from schemas.motion_rule import PER_SECOND, MotionRule
from service.errors import UsageError
from service.settings.config import load_settings
from workers.lab.calibration.motion_plots import draw_speeds, draw_spreads
from workers.lab.calibration.motion_samples import MotionSample
from workers.lab.calibration.motion_thresholds import (
    instance_spreads,
    search_thresholds,
    speed_overlap,
)
from workers.parts.files import PartFiles
from workers.parts.registry import build_selfsupervised
from workers.version import version_of


def _sample(*, car_m_per_s: float, jitter_m_per_s: float, seed: int = 0) -> MotionSample:
    """A wall that stands and a car of 60 points that drives, with noise of the flow."""
    random = np.random.default_rng(seed)
    wall = np.column_stack((np.full(80, 10.0), np.linspace(-4, 4, 80), np.zeros(80)))
    car = random.uniform((5, 5, 0), (6.2, 5.5, 0.5), (60, 3))
    places = np.vstack((wall, car)).astype(np.float32)
    velocity = np.zeros((140, 3))
    velocity[80:, 0] = car_m_per_s
    velocity += random.normal(0, jitter_m_per_s, (140, 3))
    dynamic = np.arange(140) >= 80
    return MotionSample(
        log_id="a",
        places_m=places,
        flow_m=(0.1 * velocity).astype(np.float32),
        dt_s=0.1,
        weights=np.ones(140, np.int64),
        known=np.ones(140, np.bool_),
        dynamic=dynamic,
        track=np.where(dynamic, 4, 1).astype(np.int16),
    )


def test_the_search_finds_thresholds_for_a_noisier_flow_than_the_published_ones() -> None:
    samples = [_sample(car_m_per_s=5.0, jitter_m_per_s=0.3, seed=seed) for seed in range(3)]
    grid = search_thresholds(samples)
    published = next(each for each in grid if each.rule == PER_SECOND)
    assert grid[0].iou > 0.9
    assert published.iou < 0.5
    assert grid[0].rule.flow_reach_m_per_s > PER_SECOND.flow_reach_m_per_s
    assert (grid[0].hits + grid[0].missed, published.hits + published.missed) == (180, 180)


def test_speeds_of_a_clear_scene_do_not_overlap_and_equal_ones_do() -> None:
    clear = speed_overlap([_sample(car_m_per_s=8.0, jitter_m_per_s=0.02)])
    same = speed_overlap([_sample(car_m_per_s=0.0, jitter_m_per_s=0.02)])
    assert clear.overlap == 0.0
    assert same.overlap > 0.8
    assert clear.static.sum() == pytest.approx(1.0)


def test_a_rigid_instance_has_a_small_spread() -> None:
    wall, car = instance_spreads([_sample(car_m_per_s=8.0, jitter_m_per_s=0.1)])
    assert (wall.dynamic, car.dynamic, car.points) == (False, True, 60)
    assert car.spread < 0.05 < 0.3 < wall.spread
    assert car.median_m_per_s == pytest.approx(8.0, abs=0.2)


def test_both_plots_are_drawn(tmp_path: Path) -> None:
    samples = [_sample(car_m_per_s=8.0, jitter_m_per_s=0.1)]
    draw_speeds(tmp_path / "speeds.png", speed_overlap(samples), PER_SECOND)
    draw_spreads(tmp_path / "spreads.png", instance_spreads(samples), PER_SECOND)
    for name in ("speeds.png", "spreads.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_the_file_reaches_the_stream_and_its_version(tmp_path: Path) -> None:
    rule = MotionRule(max_spread=0.5)
    path = tmp_path / "rule.json"
    path.write_text(rule.model_dump_json())
    settings = load_settings(
        bucket=str(tmp_path), selfsupervised="two-stage", motion_rule=str(path)
    ).mining()
    assert MotionRule.model_validate_json(settings.motion_rule) == rule
    files = PartFiles(motion_rule=settings.motion_rule)
    assert (
        build_selfsupervised("two-stage", files).version
        != build_selfsupervised("two-stage", PartFiles()).version
    )
    assert version_of(settings) != version_of(settings.model_copy(update={"motion_rule": ""}))


def test_a_rule_that_no_stream_reads_is_refused() -> None:
    with pytest.raises(ValidationError, match="only the self-supervised streams `two-stage`"):
        MiningSettings(bucket="b", artifacts="a", motion_rule="{}")


@pytest.mark.parametrize(
    ("content", "message"), [(None, "No such file"), ("{", "Invalid JSON"), ('{"a": 1}', "a: ")]
)
def test_a_damaged_file_is_refused_with_a_sentence(
    tmp_path: Path, content: str | None, message: str
) -> None:
    path = tmp_path / "rule.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(UsageError, match=message):
        load_settings(
            bucket=str(tmp_path), selfsupervised="two-stage", motion_rule=str(path)
        ).mining()
