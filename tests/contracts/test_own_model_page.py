"""The adapter on the page is understood, and every entry that there is stands on the page."""

import re
from pathlib import Path

from schemas.camera import CameraCalibration
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


def test_the_camera_on_the_page_of_checkpoints_is_understood() -> None:
    page = (PAGE.parents[1] / "workers" / "checkpoints" / "README.md").read_text()
    (example,) = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    camera = CameraCalibration.model_validate_json(example)
    assert camera.extrinsics[2, 0] == 1.0, "looks ahead"
