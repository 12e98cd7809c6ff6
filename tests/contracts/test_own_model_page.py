"""The adapter on the page is understood, and every entry that there is stands on the page."""

import re
from pathlib import Path

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
