"""The page of parts is what the catalogue says."""

from pathlib import Path

from service.cli.parts import part_cards, parts_page

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "PARTS.md"


def test_the_page_of_parts_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == parts_page(list(part_cards())), (
        "the catalogue changed: run `counterpoint parts --markdown > deploy/PARTS.md`"
    )
