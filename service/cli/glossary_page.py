"""Generator of `deploy/GLOSSARY.md`: `python -m service.cli.glossary_page > deploy/GLOSSARY.md`."""

import inspect
import re
from collections.abc import Iterator, Mapping

from service.cli.output import page
from workers.contradiction.explanations import TOLD
from workers.contradiction.track_features import Evidence
from workers.lab.simulation.faults.plan import DISTURBANCE_MEANS, FAILURE_MEANS

_HEAD = """\
# What reasons and reports name

Written by `python -m service.cli.glossary_page`. The words of the system itself, from log to
selection, stand in [`schemas/README.md`](../schemas/README.md).
"""


def evidence_means() -> dict[str, str]:
    """Return the meaning of each evidence field, as its class documents it."""
    text = inspect.getdoc(Evidence) or ""
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
            "What the model on a simulated car was made to do, by `simulate` and `demo`.",
            ("kind", "the model on the car"),
            failures,
        ),
        *_section(
            "Disturbances",
            "What disturbs a simulated scene without being a failure of the model.",
            ("kind", "the recording"),
            disturbances,
        ),
        *_section(
            "What is told of a track",
            "In reasons and records, `for` a verdict, `against` it, or neither (`also`). All are "
            "read off points, none is the truth: of a pole or rail passed fast few points are seen "
            "before and after, and it may be told to come from elsewhere or to leave its place.",
            ("words", "meaning"),
            TOLD,
        ),
        *_section(
            "Evidence",
            "The numbers, each 0 to 1, that the chances of a verdict follow from by one table "
            "([`attribution.json`](../workers/contradiction/attribution.json)).",
            ("name", "what it is"),
            evidence_means(),
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
