"""The pages link to what exists, and the README stays short enough to be read."""

import re
from collections import Counter
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
ROOMS: Final = ("schemas", "service", "workers", "deploy")
PAGES: Final = sorted(
    path
    for pattern in ("*.md", *(f"{room}/**/*.md" for room in ROOMS))
    for path in ROOT.glob(pattern)
)
README: Final = ROOT / "README.md"

GENERATED: Final = frozenset({"API.md", "GLOSSARY.md", "METRICS.md", "PARTS.md", "SETTINGS.md"})

MAX_README_LINES: Final = 112
MAX_COLUMNS: Final = 120

_FENCE: Final = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_LINK: Final = re.compile(r"\]\(([^()\s]+)\)")
_TITLE: Final = re.compile(r"^#{1,6} (.+)$", re.MULTILINE)


def anchors_of(text: str) -> set[str]:
    """Return the anchors that GitHub gives the titles of a page."""
    seen: Counter[str] = Counter()
    anchors = set()
    for title in _TITLE.findall(_FENCE.sub("", text)):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower().strip()
        anchor = re.sub(r"[^\w\- ]", "", shown).replace(" ", "-")
        anchors.add(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
        seen[anchor] += 1
    return anchors


def broken_links(page: Path, text: str) -> list[str]:
    """Return the relative links of a page without a file, or without a title, behind them."""
    broken = []
    for link in _LINK.findall(re.sub(r"`[^`\n]*`", "", _FENCE.sub("", text))):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists():
            broken.append(f"{link}: no such file")
        elif anchor and target.suffix == ".md":
            titles = text if target == page else target.read_text(encoding="utf-8")
            if anchor not in anchors_of(titles):
                broken.append(f"{link}: no such title")
    return broken


def module_names(text: str) -> set[str]:
    """Return the paths of this repository that a page writes as code."""
    return set(re.findall(r"`((?:schemas|service|workers|tests)(?:/\w+)+\.py)`", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_relative_link_leads_to_a_file_and_a_title(page: Path) -> None:
    assert broken_links(page, page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page.name not in {"DECISIONS.md", "CHANGELOG.md"}],
    ids=lambda page: page.relative_to(ROOT).as_posix(),
)
def test_every_module_that_a_page_names_exists(page: Path) -> None:
    named = module_names(page.read_text(encoding="utf-8"))
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []


def test_a_broken_link_and_a_missing_title_are_found() -> None:
    text = (
        "# One `two`: three\n[a](nowhere.md) [b](#one-two-three) [c](#four) [d](README.md#four)\n"
    )
    assert broken_links(README, text) == [
        "nowhere.md: no such file",
        "#four: no such title",
        "README.md#four: no such title",
    ]
    assert module_names("`workers/nowhere.py`, `workers`") == {"workers/nowhere.py"}


def wide_lines(text: str) -> list[str]:
    """Return the lines of prose that are too long: tables and code are left out."""
    lines = _FENCE.sub("", text).splitlines()
    return [
        each for each in lines if len(each) >= MAX_COLUMNS and not each.lstrip().startswith("|")
    ]


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page.name not in GENERATED],
    ids=lambda page: page.relative_to(ROOT).as_posix(),
)
def test_the_prose_of_every_page_is_narrow(page: Path) -> None:
    assert wide_lines(page.read_text(encoding="utf-8")) == []


def test_a_wide_line_is_found_and_a_wide_row_is_not() -> None:
    wide = "word " * 30
    assert wide_lines(f"{wide}\n| {wide} |\n```\n{wide}\n```\n") == [wide]


def test_the_readme_is_short_and_narrow() -> None:
    lines = README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_README_LINES
    assert [line for line in lines if len(line) >= MAX_COLUMNS] == []
