import re
from pathlib import Path

from service.cli.api_page import api_page, public_names
from service.client import Counterpoint

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "API.md"

ELSEWHERE = {"ControlClient", "Locks"}
"""Names that the page mentions and does not describe: they are no notebook's."""


def test_the_page_of_the_client_is_that_of_its_docstrings() -> None:
    assert PAGE.read_text(encoding="utf-8") == api_page(), (
        "the client or a record changed: run `python -m service.cli.api_page > deploy/API.md`"
    )


def test_every_public_name_and_method_has_a_title_and_each_record_is_there_once() -> None:
    titles = re.findall(r"^##+ (.+)$", api_page(), flags=re.MULTILINE)
    assert len(titles) == len(set(titles))
    methods = {name for name in vars(Counterpoint) if not name.startswith("_")}
    assert len(methods) > 15
    assert {f"Counterpoint.{name}" for name in methods} <= set(titles)
    assert public_names() - ELSEWHERE <= set(titles)
    assert {"SceneScore", "ListedScene", "Overlay", "VerdictRow", "ScenesRequest"} <= set(titles)
