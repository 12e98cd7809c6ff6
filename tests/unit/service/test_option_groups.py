"""Options that verbs share are written once."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any

import pytest
import typer

from service.cli.main import app_of
from service.cli.option_groups import MiningOptions, grouped
from service.settings.config import Settings
from service.settings.sources import flag_of, leaves

OF_TWO_MEANINGS = {
    "--odometry": "what a run uses, and those that one verb compares",
    "--preset": "settings of mining, and a schedule of training",
    "--bucket": "what is mined, and what the id of one log is relative to",
    "--listen": "the endpoint of a router, and the address of the review page",
    "--state": "what a daemon writes, and what is read without one",
}
MINING = {flag_of(field.name) for field in fields(MiningOptions)}


def verbs(command: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each verb with its options, by flag."""
    below = getattr(command, "commands", None)
    if not below:
        yield name, {each.opts[0]: each for each in command.params}
    for verb, each in (below or {}).items():
        yield from verbs(each, f"{name} {verb}".strip())


VERBS = dict(verbs(typer.main.get_command(app_of())))
del VERBS["simulate"]["--odometry"]  # what a simulated car records


@pytest.mark.parametrize("verb", ["run", "service", "score", "config", "doctor", "bench failures"])
def test_a_verb_that_mines_takes_every_option_of_mining(verb: str) -> None:
    assert set(VERBS[verb]) >= MINING


def test_no_verb_lists_options_of_mining_by_hand() -> None:
    partly = {
        verb: MINING & set(options)
        for verb, options in VERBS.items()
        if MINING & set(options) not in (set(), MINING)
    }
    assert partly == {
        "inspect": {"--predictions"},
        "worker": {"--model", "--predictions", "--weights"},
        **{verb: {"--weights"} for verb in ("adapt", "calibrate motion", "eval motion")},
        **{verb: {"--weights"} for verb in ("eval flow", "eval ground", "eval semantics")},
        "eval odometry": {"--odometry", "--weights"},
        "eval shards": {"--selfsupervised"},
        "train": {"--preset"},
    }


def test_the_flag_of_a_setting_has_one_help_text() -> None:
    texts = defaultdict[str, set[str]](set)
    flags = {flag_of(setting) for setting in leaves(Settings)} - {"--workers"}
    for options in VERBS.values():
        for flag in flags & set(options):
            texts[flag].add(options[flag].help)
    assert {flag for flag, said in texts.items() if len(said) > 1} == set(OF_TWO_MEANINGS)


@dataclass(frozen=True)
class Colours:
    car: Annotated[str, typer.Option("--car", help="Of the car.")] = "red"
    road: Annotated[str, typer.Option("--road", help="Of the road.")] = "grey"


def test_a_group_is_read_as_options_and_given_as_one_value() -> None:
    seen: list[object] = []

    @grouped
    def paint(*, times: int = 1, colours: Colours) -> None:
        seen.append((times, colours))

    small = typer.Typer(add_completion=False)
    small.command()(paint)
    command = typer.main.get_command(small)
    command.main(["--road", "blue"], standalone_mode=False)
    assert seen == [(1, Colours(road="blue"))]
    assert [each.opts[0] for each in command.params] == ["--times", "--car", "--road"]
