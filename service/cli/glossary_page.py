"""Generator of `deploy/GLOSSARY.md`: `python -m service.cli.glossary_page > deploy/GLOSSARY.md`."""

import inspect
import re
from collections.abc import Iterator, Mapping

from service.cli.output import page
from workers.contradiction.explanations import TOLD
from workers.contradiction.track_features import Evidence
from workers.lab.simulation.faults.plan import DISTURBANCE_MEANS, FAILURE_MEANS

_HEAD = """\
# Glossary of reasons and reports

Written by `python -m service.cli.glossary_page`. The words of the system itself, from log to
selection, are in [`schemas/README.md`](../schemas/README.md).
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
            "Errors that `simulate` and `demo` inject into the labels of the model on a "
            "simulated car.",
            ("kind", "the model on the car"),
            failures,
        ),
        *_section(
            "Disturbances",
            "Disturbances of a simulated scene that are no failures of the model.",
            ("kind", "the recording"),
            disturbances,
        ),
        *_section(
            "Properties of a track",
            "Reasons and records list them `for` an attribution, `against` it, or as neutral "
            "(`also`). All are measured on points, and none is the truth. A pole or rail that is "
            "passed fast has few points before and after, and may seem to arrive or to leave.",
            ("words", "meaning"),
            TOLD,
        ),
        *_section(
            "Evidence",
            "Numbers from 0 to 1, from which one table "
            "([`attribution.json`](../workers/contradiction/attribution.json)) computes the "
            "probabilities of an attribution.",
            ("name", "meaning"),
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
