import json

import pytest

from schemas.mining import MiningSettings
from schemas.parts import PART_LINES
from service.cli.main import main
from workers.parts.catalogue import part_cards
from workers.parts.networks import NETWORKS, known_configs, read_known
from workers.parts.registry import INSTANCES, ODOMETRIES, SELFSUPERVISED, SUPERVISED, WITNESSES


def test_every_part_that_can_be_chosen_is_described_once() -> None:
    described = [(card.part, card.name) for card in part_cards()]
    tables = {
        "odometry": ODOMETRIES,
        "supervised": SUPERVISED,
        "selfsupervised": SELFSUPERVISED,
        "witness": WITNESSES,
        "instances": INSTANCES,
    }
    chosen = [(kind, name) for kind, table in tables.items() for name in table]
    chosen += [("network", name) for name in NETWORKS]
    assert sorted(described) == sorted(chosen)
    assert {kind: set(table) for kind, table in tables.items()} == {
        kind: set(lines) for kind, lines in PART_LINES.items()
    }


def test_the_default_of_each_kind_stands_first_and_is_what_runs() -> None:
    defaults = [card for card in part_cards() if card.default]
    settings = MiningSettings(bucket=".", artifacts=".")
    assert [card.name for card in defaults] == [
        settings.odometry,
        settings.supervised,
        settings.selfsupervised,
        settings.witness,
        settings.instances,
    ]
    kinds = [card.part for card in part_cards()]
    assert [kinds.index(card.part) for card in defaults] == [
        part_cards().index(card) for card in defaults
    ]


def test_what_needs_weights_that_do_not_ship_says_so() -> None:
    cards = {card.name: card for card in part_cards()}
    assert cards["salsanext-lmnet"].weights.startswith("ships")
    assert "adapter" in cards["own"].weights
    assert cards["registration"].weights == "none"
    assert all(card.licence and card.source and card.what.endswith(".") for card in cards.values())


def test_every_configuration_that_ships_is_named_by_its_network() -> None:
    networks = {card.name: card.weights for card in part_cards() if card.part == "network"}
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
