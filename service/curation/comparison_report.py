"""Report of a comparison in Markdown, for the notes of a release. Pure."""

from collections.abc import Iterator
from typing import Final

from service.curation.compared_scenes import LOGS_AT_A_PLACE
from service.curation.comparison import MOST_PLACES, ComparedGroup, Comparison, Rate
from service.curation.comparison_answers import MOST_LESS

_WORDS: Final = {"regressed": "**regressed**", "improved": "improved", "same": "no difference"}


def gate_sentence(found: Comparison) -> str:
    """Return the result in one sentence."""
    a, b = found.a.labelled_share, found.b.labelled_share
    if found.answers_less:
        return (
            f"B answers less: it labels {100 * b:.0f} % of the returns, A {100 * a:.0f} %, and "
            f"what is not labelled cannot contradict; {_of_groups(found)}"
        )
    if b - a > MOST_LESS:
        return (
            f"{_of_groups(found)}; B labels {100 * b:.0f} % of the returns, A only "
            f"{100 * a:.0f} %, so that more of B can contradict"
        )
    return _of_groups(found)


def _of_groups(found: Comparison) -> str:
    kinds = found.roads - found.places
    roads = f"{kinds} kinds of road" if kinds or not found.places else ""
    places = f"{found.places} place{'s' * (found.places > 1)}" if found.places else ""
    how = (
        "the same logs" if found.matched == "logs" else " and ".join(filter(None, (places, roads)))
    )
    tests = f"{found.comparisons} comparisons over {how}, corrected by Holm"
    if found.regressed:
        worst = found.groups[0]
        return (
            f"{found.regressed} of {tests}, regressed: first {group_name(worst)}, "
            f"{worst.a.per_hour:.1f} to {worst.b.per_hour:.1f} tracks per hour"
        )
    if not found.comparisons:
        return "nothing was compared: every group has too few tracks or logs"
    return f"none of {tests}, regressed; {found.improved} improved"


def group_name(row: ComparedGroup) -> str:
    """Return the name of a group for people."""
    if row.by == "all":
        return "all tracks"
    if row.by == "mode":
        return f"{row.group} ({row.name})"
    return f"{row.by} {row.group.replace('_', ' ') or 'none'}"


def place_lines(found: Comparison, *, most: int) -> Iterator[str]:
    """Yield a line for each compared place up to a number, and lines for the others."""
    for row in found.at_places[:most]:
        a, b = row.a, row.b
        yield (
            f"place {row.place}: logs {a.logs} of A and {b.logs} of B, scenes {a.scenes} and "
            f"{b.scenes}, strong tracks {a.tracks} and {b.tracks}"
        )
    if found.places > most:
        yield f"and {found.places - most} more place{'s' * (found.places - most > 1)}"
    if found.places_too_few:
        yield (
            f"{found.places_too_few} place{'s' * (found.places_too_few > 1)} that both sides "
            f"passed, one of them on fewer than {LOGS_AT_A_PLACE} logs: compared by kind of road"
        )


def markdown(found: Comparison) -> str:
    """Return the report of a comparison."""
    return "\n".join(_lines(found)) + "\n"


def _lines(found: Comparison) -> Iterator[str]:
    yield f"# {'No regression' if found.passed else 'Regression'}: B against A"
    yield ""
    sentence = gate_sentence(found)
    yield f"{sentence[:1].upper()}{sentence[1:]}. Tolerance: {100 * found.tolerance:.0f} %."
    yield ""
    yield "| side | version | logs | scenes | hours | left out | labelled |"
    yield "|---|---|---|---|---|---|---|"
    for side, row in (("A", found.a), ("B", found.b)):
        yield (
            f"| {side} | {_cell(row.name)} | {row.logs} | {row.scenes} | {row.hours:.3f} | "
            f"{row.left_out} | {100 * row.labelled_share:.1f} % |"
        )
    yield ""
    yield "Rates are strong tracks on which the supervised stream errs, per hour driven, with 95 %"
    yield "intervals by log. The p is corrected by Holm, and so is the interval of the difference."
    yield ""
    same = found.matched == "logs"
    extra = " gone | new |" if same else ""
    yield f"| group | A | B | B - A | p | result |{extra}"
    yield "|---|---|---|---|---|---|" + ("---|---|" if same else "")
    for group in found.groups:
        more = f" {group.gone} | {group.new} |" if same else ""
        yield (
            f"| {_cell(group_name(group))} | {_rate(group.a)} | {_rate(group.b)} | "
            f"{group.difference:+.1f} ({group.corrected_low:.1f} to {group.corrected_high:.1f}) | "
            f"{group.corrected_p:.3g} | {_WORDS[group.outcome]} |{more}"
        )
    if found.at_places or found.places_too_few:
        yield ""
        yield "## Places compared by themselves, by their south-west corner"
        yield ""
        for line in place_lines(found, most=MOST_PLACES):
            yield f"* {_cell(line)}"
    if found.too_few:
        yield ""
        yield f"{found.too_few} further groups have too few tracks or logs to compare."
    for group in found.groups:
        if group.examples:
            yield ""
            yield f"## Scenes that show it: {_cell(group_name(group))}, {group.outcome}"
            yield ""
            for each in group.examples:
                yield (
                    f"* `{each.scene_id}`, track {each.track_id + 1} of {each.side.upper()}, "
                    f"strength {each.strength:.2f}: {_cell(each.headline)}"
                )


def _rate(rate: Rate) -> str:
    return f"{rate.per_hour:.1f} ({rate.low:.1f} to {rate.high:.1f})"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
