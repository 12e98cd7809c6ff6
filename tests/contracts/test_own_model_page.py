"""Examples of the page on your own model are read, and it names every entry and column."""

import re
from pathlib import Path

import numpy as np
import pytest

from schemas.camera import CameraCalibration
from tests.box_logs import clouds, read, stamp, write
from workers.ingest.boxes.parquet import NEEDED, OPTIONAL
from workers.supervised.adapter import Adapter, NetworkEntry

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "OWN_MODEL.md"


def test_the_adapter_on_the_page_is_understood(tmp_path: Path) -> None:
    (example,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    path = tmp_path / "adapter.toml"
    path.write_text(example)
    adapter = Adapter.read(path)
    assert adapter.semantic is not None
    assert adapter.motion is not None
    assert [one.name for one in adapter.motion.classes if one.moving] == ["moving"]


def test_every_entry_stands_on_the_page() -> None:
    page = PAGE.read_text()
    for name in (*Adapter.model_fields, *NetworkEntry.model_fields):
        assert re.search(rf"\b{name}\b", page), f"{name} is not explained"


Answers = dict[int, list[list[object]]]


def write_boxes(answers: Answers) -> None:
    (example,) = re.findall(r"```python\n(from pathlib.*?)```", PAGE.read_text(), re.DOTALL)
    exec(example, {"answers": answers})  # noqa: S102  what the page tells a person to run


def test_the_boxes_that_the_page_writes_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    box = [5.0, 1.0, 0.5, 4.0, 2.0, 1.5, np.pi / 2, 3.0, 0.0, "car", 0.9, "17"]
    answers: Answers = {stamp(number): [box] for number in range(18)}
    write_boxes(answers | {stamp(3): []})
    frames, said = read(write(clouds()), predictions="predictions")
    found = [None if frame.boxes is None else len(frame.boxes.centre_m) for frame in frames]
    assert found == [1, 1, 1, 0, *[1] * 14, None, None], "a row of the stamp alone is an answer"
    first = frames[0].boxes
    assert first is not None
    np.testing.assert_allclose(first.centre_m, [[5.0, 1.0, 0.5]], err_msg="the centre")
    np.testing.assert_allclose(first.sensor_from_box[0] @ [1, 0, 0], [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(first.velocity_m_per_s, [[3, 0, 0]], err_msg="axes of the frame")
    assert [each for each in said if "2 clouds have no answer" in each]


def test_the_classes_on_the_page_map_names_and_numbers_of_boxes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    place = [5.0, 1.0, 0.5, 4.0, 2.0, 1.5, 0.0, 0.0, 0.0]
    names = ["Forklift", "Roadworks-Sign", "1", "Car", "gizmo"]
    boxes: list[list[object]] = [
        [*place, name, 0.9, str(number)] for number, name in enumerate(names)
    ]
    write_boxes({stamp(number): boxes for number in range(20)})
    (example,) = re.findall(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)
    Path("predictions/classes.json").write_text(example)
    frames, said = read(write(clouds()), predictions="predictions")
    found = frames[0].boxes
    assert found is not None
    assert found.movable == (True, False, False, True, None)
    sign = "roadworks sign"
    assert found.class_name == ("forklift", sign, sign, "Car", "gizmo")
    assert [each for each in said if "no mapping knows 1 classes of boxes: 'gizmo'" in each]


def test_every_column_of_boxes_stands_on_the_page() -> None:
    page = PAGE.read_text()
    for name in (*NEEDED, *OPTIONAL):
        if name not in {"qy", "qz"}:
            assert f"`{name}`" in page, f"{name} is not explained"


def test_the_camera_on_the_page_of_checkpoints_is_understood() -> None:
    page = (PAGE.parents[1] / "workers" / "checkpoints" / "README.md").read_text()
    (example,) = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    camera = CameraCalibration.model_validate_json(example)
    assert camera.extrinsics[2, 0] == 1.0, "looks ahead"
