import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter

from schemas.frame import LidarFrame
from service.cli.main import main
from tests import factories
from workers.errors import LogUnusableError
from workers.lab.calibration.sensor_layout import measure_layout
from workers.lab.calibration.sensor_profile import different_lidars, fit_profile, profile_text
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar
from workers.lidar.range_image import SensorProfile
from workers.supervised.adapter import Adapter

BEAMS_DEG = np.array([8.0, 3.0, 1.0, 0.0, -1.0, -2.5, -4.0, -7.0, -11.0, -16.0, -22.0, -25.0])
STEPS = 1024


def _frame(
    *,
    beams_deg: NDArray[np.float64] = BEAMS_DEG,
    seed: int = 0,
    rings: bool = True,
    order: str = "beam",
    lifted_m: float = 0.0,
) -> LidarFrame:
    """A sensor in a round hall: every beam hits the floor or the wall, 5 to 30 m away."""
    rng = np.random.default_rng(seed)
    azimuth = (np.arange(STEPS) + 0.5) / STEPS * 2 * np.pi - np.pi
    wall_m = 18 + 12 * np.sin(3 * azimuth + rng.uniform(0, 6))
    rows = []
    for number, beam in enumerate(np.radians(beams_deg)):
        floor_m = np.full(STEPS, 1.8 / -np.tan(beam)) if beam < 0 else np.full(STEPS, np.inf)
        flat_m = np.minimum(wall_m, floor_m)
        xyz = (flat_m * np.cos(azimuth), flat_m * np.sin(azimuth), flat_m * np.tan(beam) + lifted_m)
        rows.append(np.stack((*xyz, np.full(STEPS, number)), axis=1))
    points = np.stack(rows)
    if order == "column":
        points = points.swapaxes(0, 1)
    points = points.reshape(-1, 4)
    n = len(points)
    return LidarFrame(
        log_id="hall",
        stamp_ns=10**18 + seed,
        points_m=points[:, :3].astype(np.float32),
        intensity=rng.uniform(0, 1, n).astype(np.float32),
        offset_ns=np.zeros(n, np.int32),
        ring=points[:, 3].astype(np.int16) if rings else np.full(n, -1, np.int16),
        valid_mask=np.ones(n, np.bool_),
    )


@pytest.mark.parametrize(
    ("rings", "order"),
    [
        pytest.param(True, "beam", id="numbered, beam by beam"),
        pytest.param(True, "column", id="numbered, column by column"),
        pytest.param(False, "beam", id="not numbered, but in order"),
    ],
)
def test_each_beam_gets_its_row(rings: bool, order: str) -> None:
    layout = measure_layout([_frame(seed=s, rings=rings, order=order) for s in range(3)])
    assert (layout.rows, layout.beams, layout.columns) == (16, 12, 1024)
    assert layout.steps_per_turn == pytest.approx(STEPS, abs=1)
    assert layout.elevations_deg is not None
    np.testing.assert_allclose(layout.elevations_deg[4:], BEAMS_DEG, atol=0.01)
    assert "16 rows, 12 beams" in layout.remarks[-1]


def test_beams_that_are_neither_numbered_nor_in_order_are_counted_by_their_gaps() -> None:
    even = np.linspace(10, -20, 32)
    layout = measure_layout([_frame(beams_deg=even, rings=False, order="column")])
    assert layout.elevations_deg is None
    assert layout.rows == 32
    assert layout.fov_up_deg == pytest.approx(10.5, abs=0.5)
    assert layout.fov_down_deg == pytest.approx(-20.5, abs=0.5)
    assert "neither numbered nor in order" in layout.remarks[0]


def test_beams_that_meet_beside_the_origin_get_rows_in_which_more_is_seen() -> None:
    lifted = [_frame(beams_deg=np.linspace(2, -24, 32), lifted_m=0.9, seed=s) for s in range(2)]
    layout = measure_layout(lifted)
    assert layout.beams == 32
    assert (layout.elevations_deg is None) == any("evenly spaced" in r for r in layout.remarks)


def test_means_and_deviations_are_those_of_what_is_seen() -> None:
    frames = [_frame(seed=s) for s in range(3)]
    fit = fit_profile(frames, name="hall")
    assert fit.seen_share == pytest.approx(1.0, abs=0.01)
    assert fit.projected_share == 1.0
    assert fit.filled_share == pytest.approx(12 / 16, abs=0.01)
    points = np.concatenate([frame.points_m for frame in frames])
    expected = np.column_stack((np.linalg.norm(points, axis=1), points))
    np.testing.assert_allclose(fit.profile.means[:4], expected.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(fit.profile.stds[:4], expected.std(axis=0), rtol=0.02)
    assert fit.profile.means[4] == pytest.approx(0.5, abs=0.02)


def test_what_never_varies_is_divided_by_one() -> None:
    frame = _frame()
    still = replace(frame, intensity=np.zeros(len(frame), np.float32))
    fit = fit_profile([still], name="hall")
    assert fit.profile.stds[4] == 1.0
    assert any(remark.startswith("intensity never varies") for remark in fit.remarks)


def test_rows_and_columns_may_be_asked_for() -> None:
    profile = fit_profile([_frame()], name="hall", rows=48, columns=512).profile
    assert (profile.rows, profile.columns, profile.elevations_deg) == (48, 512, None)


def test_a_handful_of_points_is_no_sensor() -> None:
    frame = _frame(beams_deg=BEAMS_DEG[3:4])
    with pytest.raises(LogUnusableError, match="cannot calibrate the sensor"):
        fit_profile([frame], name="hall")
    nothing = replace(frame, valid_mask=np.zeros(len(frame), np.bool_))
    with pytest.raises(LogUnusableError, match="no frame has a valid point"):
        fit_profile([nothing], name="hall")


def test_a_frame_without_a_return_changes_nothing() -> None:
    nothing = replace(_frame(), valid_mask=np.zeros(len(_frame()), np.bool_))
    assert fit_profile([_frame(), nothing], name="hall") == fit_profile([_frame()], name="hall")


def test_a_profile_is_read_back_from_json_and_by_an_adapter(tmp_path: Path) -> None:
    profile = fit_profile([_frame()], name="hall").profile
    (tmp_path / "hall.json").write_text(profile_text(profile, ".json"))
    assert (
        TypeAdapter(SensorProfile).validate_json((tmp_path / "hall.json").read_bytes()) == profile
    )
    (tmp_path / "hall.toml").write_text(profile_text(profile, ".toml"))
    written = (tmp_path / "hall.toml").read_text()
    assert tomllib.loads(written)["profile"]["rows"] == 16
    classes = '[{ name = "car", movable = true }]'
    entry = f'name = "mine"\n[semantic]\nfile = "net.onnx"\nclasses = {classes}\n'
    (tmp_path / "adapter.toml").write_text(entry + written)
    assert Adapter.read(tmp_path / "adapter.toml").image == profile


def test_another_kind_of_file_is_refused_before_anything_is_read(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["calibrate", "sensor", "nowhere.mcap", "--out", "profile.yaml"]) == 1
    assert ".json or .toml" in capsys.readouterr().err


def test_logs_of_two_lidars_are_told_apart_and_two_of_one_are_not() -> None:
    sparse = BEAMS_DEG[::2]
    mixed = different_lidars({"a": [_frame()], "b": [_frame(beams_deg=sparse)]})
    assert mixed == (
        "these look like different lidars, and a profile is of one: a has 12 beams down to -25 "
        "degrees, b has 6 down to -22"
    )
    assert not different_lidars({"a": [_frame()], "b": [_frame(seed=3)]})
    higher = different_lidars({"a": [_frame()], "b": [_frame(beams_deg=BEAMS_DEG + 7.0)]})
    assert "different lidars" in higher


def test_a_log_of_two_lidars_needs_a_topic_and_a_short_one_says_how_to_take_more(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = factories.street_log(tmp_path / "short.mcap", frames=5, lidar=Lidar(columns=720))
    out = ["--out", str(tmp_path / "p.toml")]
    assert main(["calibrate", "sensor", str(log), *out]) == 0
    assert "frames taken: 1, one of 10; --every 1 takes more" in capsys.readouterr().err
    assert main(["calibrate", "sensor", str(log), *out, "--every", "1"]) == 1
    assert "--force" in capsys.readouterr().err, "a profile may have been edited by hand"
    assert main(["calibrate", "sensor", str(log), *out, "--every", "1", "--force"]) == 0
    assert "--every" not in capsys.readouterr().err


@pytest.mark.reference
def test_a_real_sensor_gets_its_beams_from_its_log(reference: Path, tmp_path: Path) -> None:
    log = "data/logs/pandaset/panda-01/2019-05-11/pandaset-002.mcap"
    out = tmp_path / "pandar64.json"
    arguments = [str(reference / log), "--out", str(out), "--frames", "2", "--every", "5"]
    assert main(["calibrate", "sensor", *arguments]) == 0
    profile = TypeAdapter(SensorProfile).validate_json(out.read_bytes())
    assert profile.elevations_deg is not None
    np.testing.assert_allclose(profile.elevations_deg, UNEVEN_64, atol=0.15)  # beams are 0.17 apart
