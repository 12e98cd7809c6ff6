"""The changelog states which layers a release changes; `deploy/layers.json` has the last ones."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pytest

from workers.layers import Layer, shipped_digests

ROOT: Final = Path(__file__).parents[2]
RELEASED: Final = ROOT / "deploy" / "layers.json"
STATED: Final = re.compile(r"^- \*\*Layers changed\*\*: ([a-z, ]+)[.:]", re.MULTILINE)
HOW: Final = (
    "state them in the first line of CHANGELOG.md's Unreleased section, such as `- **Layers "
    "changed**: labels, score.`; a release stores them: `python -m workers.layers RELEASE "
    "deploy/layers.json`"
)


def stated(changelog: str) -> set[str]:
    """Return the layers that the Unreleased section states as changed."""
    unreleased = changelog.partition("## [Unreleased]")[2].partition("\n## [")[0]
    found = STATED.search(unreleased)
    return {each.strip() for each in found.group(1).split(",")} - {"none"} if found else set()


def changed(before: Mapping[str, str], now: Mapping[Layer, str]) -> set[str]:
    """Return the layers whose digest is another one than at the last release."""
    return {layer.value for layer in Layer if before.get(layer.value) != now[layer]}


def test_the_changelog_states_exactly_the_layers_that_changed_since_the_last_release() -> None:
    before = json.loads(RELEASED.read_text(encoding="utf-8"))["layers"]
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert stated(changelog) == changed(before, shipped_digests()), HOW


@pytest.mark.parametrize(
    ("line", "layers"),
    [
        ("- **Layers changed**: score.", {"score"}),
        ("- **Layers changed**: labels, score: all is mined again.", {"labels", "score"}),
        ("- **Layers changed**: none.", set()),
        ("- Something else.", set()),
    ],
)
def test_a_statement_is_read_from_the_unreleased_section_alone(line: str, layers: set[str]) -> None:
    text = (
        f"# Changelog\n\n## [Unreleased]\n\n{line}\n\n## [0.1.0]\n\n- **Layers changed**: labels.\n"
    )
    assert stated(text) == layers


def test_a_change_that_is_not_stated_is_found() -> None:
    now = shipped_digests()
    before = {layer.value: digest for layer, digest in now.items()}
    assert changed(before, now) == set()
    assert changed(before | {"score": "another"}, now) == {"score"}
    assert changed({}, now) == {layer.value for layer in Layer}
