"""Costs of a fleet: linear in frames, from measured or stated rates."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli.main import app_of
from service.fleet_costs import Fleet, FrameRates, Prices, costs_of


def test_a_fleet_costs_what_its_frames_cost() -> None:
    rates = FrameRates(seconds=0.36, bytes_read=1e6, overlay_bytes=5e5)
    found = costs_of(Fleet(100, 8.0, keep_days=10.0), rates, Prices(0.05, 0.02, 0.01))
    assert found.frames_a_day == 28_800_000
    assert found.scenes_a_day == 1_440_000
    assert found.core_hours_a_day == pytest.approx(2880)
    assert found.cores == pytest.approx(120)
    assert found.read_gb_a_day == pytest.approx(28_800)
    assert found.overlay_gb_kept == pytest.approx(144_000)
    assert found.core_money_a_month == pytest.approx(4320)
    assert found.read_money_a_month == pytest.approx(8640)
    assert found.disk_money_a_month == pytest.approx(2880)
    assert found.money_a_month == pytest.approx(15_840)
    assert found.money_an_hour_driven == pytest.approx(0.66)


def test_twice_the_cars_cost_twice_as_much_but_an_hour_costs_the_same() -> None:
    one, two = (costs_of(Fleet(n, 8.0), FrameRates(), Prices()) for n in (50, 100))
    assert two.money_a_month == pytest.approx(2 * one.money_a_month)
    assert two.money_an_hour_driven == pytest.approx(one.money_an_hour_driven)


def test_the_command_states_its_basis_and_prints_numbers_for_programs(tmp_path: Path) -> None:
    asked = ["plan", "--cars", "100", "--hours", "8", "--state", str(tmp_path / "none")]
    told = CliRunner().invoke(app_of("plan"), asked)
    assert told.exit_code == 0, told.output
    assert "as measured elsewhere" in told.output
    found = json.loads(CliRunner().invoke(app_of("plan"), [*asked, "--json"]).stdout)
    assert found["frames_a_day"] == 28_800_000
    assert found["measured_frames"] == 0
