"""Generator of `deploy/GLOSSARY.md`: `python -m service.cli.glossary_page > deploy/GLOSSARY.md`."""

import inspect
import re
from collections.abc import Iterator, Mapping

from service.cli.output import page
from workers.contradiction.explanations import EXPLANATION_TEXTS
from workers.contradiction.track_features import TrackFeatures
from workers.lab.simulation.faults.plan import DISTURBANCE_MEANS, FAILURE_MEANS

_HEAD = """\
# Names in reasons and reports

Written by `python -m service.cli.glossary_page`. [`schemas/README.md`](../schemas/README.md)
defines the terms of the system itself, from log to selection.
"""


def feature_meanings() -> dict[str, str]:
    """Return the meaning of each feature, as its class documents it."""
    text = inspect.getdoc(TrackFeatures) or ""
    rows = re.findall(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", text, flags=re.MULTILINE)
    return {name: " ".join(meaning.split()).rstrip(".") for name, meaning in rows}


def glossary_page() -> str:
    """Return the page."""
    failures = {kind.value: means for kind, means in FAILURE_MEANS.items()}
    disturbances = {kind.value: means for kind, means in DISTURBANCE_MEANS.items()}
    lines = [
        _HEAD,
        *_section(
            "Planted failures",
            "Errors that `simulate` and `demo` give to the model on a simulated car.",
            ("kind", "the model on the car"),
            failures,
        ),
        *_section(
            "Disturbances",
            "Disturbances of a simulated scene that are no failure of the model.",
            ("kind", "the recording"),
            disturbances,
        ),
        *_section(
            "Evidence",
            "Phrases in reasons and records that support an attribution, oppose it, or are "
            "neutral. All are measured on points, and none is the truth. A pole or rail passed at "
            "speed has few points before and after, for example, and may have the evidence "
            "`arrival from elsewhere` or `departure from its place`.",
            ("phrase", "meaning"),
            EXPLANATION_TEXTS,
        ),
        *_section(
            "Track features",
            "Numbers from 0 to 1, from which one table "
            "([`attribution.json`](../workers/contradiction/attribution.json)) computes the "
            "probability of each attribution.",
            ("name", "meaning"),
            feature_meanings(),
        ),
    ]
    return "\n".join(lines) + "\n"


def _section(
    title: str, about: str, columns: tuple[str, str], rows: Mapping[str, str]
) -> Iterator[str]:
    yield f"## {title}\n\n{about}\n"
    yield f"| {columns[0]} | {columns[1]} |\n|---|---|"
    for name, means in rows.items():
        shown = f"`{name}`" if name.replace("_", "").isalnum() else name
        yield f"| {shown} | {means} |"
    yield ""


if __name__ == "__main__":
    page(glossary_page())
