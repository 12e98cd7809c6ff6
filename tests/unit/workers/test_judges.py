"""Judges of flow, ground and odometry: figures that are known, and truth that is missing."""

from pathlib import Path

import numpy as np
import pytest
import torch

from schemas.mining import MiningSettings
from service.cli.main import main
from tests.dataset_folders.made_up import write_once
from workers.checkpoints.stored_weights import save
from workers.lab.datasets.conversion.convert import convert
from workers.lab.datasets.published.catalogue import find_layout, open_logs
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.evaluation.flow.flow import evaluate_flow
from workers.lab.evaluation.ground.ground import evaluate_ground, heights_of
from workers.lab.evaluation.odometry.odometry import errors_of, evaluate_odometry
from workers.lab.simulation.faults.plan import plan_fleet
from workers.lab.simulation.output.fleet import FleetOptions, write_planned
from workers.paper.weights import DeLORACard, FlowStep3DCard


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One simulated log of two seconds."""
    folder = tmp_path_factory.mktemp("fleet")
    (plan,) = plan_fleet(scenes=1, seed=3, share=0.0, log_s=(2.0, 2.0))
    write_planned(folder, plan, options=FleetOptions(columns=512))
    return folder


def settings_of(fleet: Path) -> MiningSettings:
    return MiningSettings(bucket=str(fleet / "logs"), artifacts="memory://")


def test_flow_knows_its_floors_and_true_flow_by_boxes(fleet: Path) -> None:
    rows, without = evaluate_flow(
        str(fleet / "logs"), fleet / "truth", frames=range(8), settings=settings_of(fleet)
    )
    assert without == []
    of = {row.flow: row for row in rows if row.log == "all"}
    assert list(of) == ["zero", "ego-motion", "nearest-neighbour", "registered-clusters"]
    ego, zero = of["ego-motion"].epe_m, of["zero"].epe_m
    assert ego["static"] is not None
    assert zero["static"] is not None
    assert ego["static"] < 0.5 * zero["static"]
    stated = of["ego-motion"]
    for path in (fleet / "truth").rglob("0*.npz"):
        with np.load(path) as arrays:
            kept = {name: arrays[name] for name in arrays if name != "flow"}
        np.savez_compressed(path, **kept)
    again, _ = evaluate_flow(
        str(fleet / "logs"), fleet / "truth", frames=range(8), settings=settings_of(fleet)
    )
    derived = next(row for row in again if row.log == "all" and row.flow == "ego-motion")
    assert derived.points["dynamic"] == pytest.approx(stated.points["dynamic"], rel=0.1)
    for kind, metres in (("static", 0.01), ("dynamic", 0.05)):
        if stated.epe_m[kind] is not None:
            assert derived.epe_m[kind] == pytest.approx(stated.epe_m[kind], abs=metres)


def test_ground_has_points_and_heights(fleet: Path) -> None:
    rows, _ = evaluate_ground(
        str(fleet / "logs"),
        fleet / "truth",
        frames=range(4),
        settings=settings_of(fleet),
        methods=["ground"],
    )
    of = {row.method: row for row in rows if row.log == "all"}
    assert list(of) == ["ground", "patchwork++", "z-threshold"]
    for row in of.values():
        assert row.iou is not None
        assert row.iou > 0.5
        assert row.height_error_m["median"] < 0.05


def test_odometry_is_compared_with_true_poses(fleet: Path) -> None:
    rows, _ = evaluate_odometry(
        str(fleet / "logs"), fleet / "truth", frames=range(20), settings=settings_of(fleet)
    )
    of = {row.odometry: row for row in rows if row.log == "all"}
    assert list(of) == ["kiss-icp", "constant-velocity", "kiss-icp:library"]
    assert of["kiss-icp"].compared_with == "truth"
    assert of["kiss-icp"].translation_m is not None
    assert of["kiss-icp"].translation_m < 0.1
    assert of["kiss-icp"].translation_m_per_100_m is None


def test_networks_whose_weights_are_in_the_folder_are_listed_beside_the_floors(
    fleet: Path, tmp_path: Path
) -> None:
    torch.manual_seed(3)
    named = {"attribution": "none", "data_license": "none"}
    flow = FlowStep3DCard(points=64, neighbours=8, radius_m=1.5, decay=0.5, iterates=2, **named)
    motion = DeLORACard(rows=16, columns=64, fov_up_deg=2.0, fov_down_deg=-25.0, **named)
    for card in (flow, motion):
        save(tmp_path / f"{card.network}.safetensors", card.build().state_dict(), card)
    settings = settings_of(fleet).model_copy(update={"weights": str(tmp_path)})
    given = (str(fleet / "logs"), fleet / "truth")
    flows, _ = evaluate_flow(*given, frames=range(3), settings=settings)
    assert "flowstep3d" in {row.flow for row in flows}
    poses, _ = evaluate_odometry(*given, frames=range(3), settings=settings)
    assert {row.odometry for row in poses} >= {"delora", "kiss-icp", "constant-velocity"}


def test_drift_of_one_per_cent_is_a_metre_per_100_m() -> None:
    true = np.tile(np.eye(4), (300, 1, 1))
    true[:, 0, 3] = np.arange(300.0)
    estimated = true.copy()
    estimated[:, 0, 3] *= 1.01
    errors = errors_of(true, estimated, True)
    assert np.allclose(errors.segment_m, 1.0)
    assert np.allclose(errors.frame_m, 0.01)
    assert errors.end_m == pytest.approx(1.0)
    assert np.allclose(errors_of(true, None, True).frame_m, 0.0)


def test_a_cell_has_the_median_of_its_heights() -> None:
    points = np.array([[0.1, 0.1, 1], [0.2, 0.2, 5], [0.9, 0.9, 2], [7, 7, 1]], np.float32)
    cells, heights = heights_of(points, np.ones(4, np.bool_))
    assert cells.tolist() == [[0, 0]]
    assert heights.tolist() == [2.0]


@pytest.mark.parametrize(("verb", "said"), [("flow", "no log of"), ("ground", "no log of")])
def test_truth_without_what_is_judged_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, verb: str, said: str
) -> None:
    layout = find_layout("once")
    logs = open_logs(layout, write_once(tmp_path / "source"), ReadOptions())
    list(convert(layout, logs, to=str(tmp_path / "logs"), truth=tmp_path / "truth"))
    code = main(["eval", verb, str(tmp_path / "logs"), "--truth", str(tmp_path / "truth")])
    told = capsys.readouterr().err
    assert code == 1
    assert said in told
    assert "Traceback" not in told
