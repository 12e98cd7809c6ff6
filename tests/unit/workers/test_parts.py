import json
from collections import Counter
from collections.abc import Iterable, Iterator

import pytest

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from schemas.mining import MiningSettings
from schemas.task import MOTION, Task
from service.cli.main import main
from service.cli.parts import PartCard, part_cards, parts_page
from service.errors import UsageError
from service.settings.config import read_settings
from workers.parts import catalogue
from workers.parts.catalogue import PARTS, names_of
from workers.parts.files import PartFiles
from workers.parts.networks import known_configs, read_known
from workers.parts.part import KINDS, Part
from workers.parts.registry import build_selfsupervised
from workers.version import parts_of


def cards() -> list[PartCard]:
    return list(part_cards())


def test_every_row_is_described_once() -> None:
    described = [(card.part, card.name) for card in cards()]
    assert Counter(described) == Counter((part.kind, part.name) for part in PARTS)
    assert set(Counter(described).values()) == {1}
    assert {part.kind for part in PARTS} == set(KINDS)


def test_every_network_of_a_part_is_a_row() -> None:
    needed = {network for part in PARTS for network in part.networks}
    assert needed == set(names_of("network"))


def test_the_default_of_each_kind_is_first_and_is_what_runs() -> None:
    defaults = [card for card in cards() if card.default]
    settings = MiningSettings(bucket=".", artifacts=".")
    assert [card.name for card in defaults] == [
        settings.odometry,
        settings.supervised,
        settings.selfsupervised,
        settings.witness,
        settings.instances,
    ]
    kinds = [card.part for card in cards()]
    assert [kinds.index(card.part) for card in defaults] == [
        cards().index(card) for card in defaults
    ]


def test_what_needs_weights_that_do_not_ship_says_so() -> None:
    named = {card.name: card for card in cards()}
    assert named["salsanext-lmnet"].weights.startswith("ships")
    assert "adapter" in named["own"].weights
    assert named["registration"].weights == "none"
    assert named["two-stage:flowstep3d"].weights == "flowstep3d, trained or imported; none ship"
    assert all(card.licence and card.source and card.what.endswith(".") for card in cards())


def test_every_configuration_that_ships_is_named_by_its_network() -> None:
    networks = {card.name: card.weights for card in cards() if card.part == "network"}
    for config in known_configs():
        assert config in networks[read_known(config).network]


def test_parts_are_listed_as_lines_of_json_and_as_a_table(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["parts", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {"part", "name", "default", "paper", "licence", "weights", "presets"} <= set(rows[0])
    taken = {row["part"]: row["name"] for row in rows if "paper" in row["presets"]}
    assert (taken["odometry"], taken["selfsupervised"]) == ("kiss-icp", "paper")
    assert taken["instances"] == "paper"
    assert main(["parts"]) == 0
    shown = capsys.readouterr().out
    assert all(row["name"] in shown for row in rows)


class Echo:
    """A stream of somebody else: what its file would hold."""

    task: Task = MOTION
    version = "echo@1"
    class_names = ()

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        raise AssertionError("nothing is run here")


def _echo(_: PartFiles) -> Echo:
    return Echo()


def test_one_row_makes_a_part_that_is_listed_accepted_documented_and_built(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    row = Part(
        kind="selfsupervised",
        name="echo",
        factory=_echo,
        text="What was called into the street.",
        source="a test",
    )
    with pytest.raises(UsageError, match="--selfsupervised echo: must be one of registration"):
        read_settings(selfsupervised="echo")

    monkeypatch.setattr(catalogue, "PARTS", (*PARTS, row))

    assert main(["parts", "--json"]) == 0
    listed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (mine,) = [each for each in listed if each["name"] == "echo"]
    assert (mine["part"], mine["what"], mine["weights"]) == ("selfsupervised", row.text, "none")
    assert "| `echo` |" in parts_page(cards())
    settings = read_settings(selfsupervised="echo", bucket="memory://").settings
    assert main(["config", "--selfsupervised", "echo", "--json"]) == 0
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (allowed,) = [each["allowed"] for each in said if each["setting"] == "selfsupervised"]
    assert allowed.endswith(", echo")
    assert isinstance(build_selfsupervised("echo"), Echo)
    assert parts_of(settings.mining()).selfsupervised.version == "echo@1"
