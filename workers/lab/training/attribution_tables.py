"""Attribution tables as files: the one that ships, and earlier ones as priors of a fit."""

import hashlib
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from schemas.attribution import Wrong
from schemas.errors import PermanentError
from workers.contradiction.attribution import FILE
from workers.lab.training.attribution_prior import PRIOR, Row

Rows = Mapping[str, Any]
"""The rows of one kind, in the format of `attribution.json`."""

Prior = Mapping[str, Mapping[Wrong, Row]]
"""Intercepts and weights by kind and verdict, towards which a fit is drawn."""


def shipped_rows() -> dict[str, Rows]:
    """Return the rows of all kinds in the table that ships."""
    text = resources.files("workers.contradiction").joinpath(FILE).read_text(encoding="utf-8")
    return dict(json.loads(text)["kinds"])


def read_table(file: Path) -> Prior:
    """Read an earlier table as a prior; verdicts that it lacks keep the prior written by hand.

    Raises:
        PermanentError: If it cannot be read.
    """
    try:
        kinds = json.loads(file.read_text(encoding="utf-8"))["kinds"]
        return {
            kind: {
                answer: (float(kinds[kind][answer]["intercept"]), kinds[kind][answer]["weights"])
                if answer in kinds[kind]
                else row
                for answer, row in rows.items()
            }
            for kind, rows in PRIOR.items()
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PermanentError(
            f"--update: {file} is no attribution table ({error}); name a file that this command "
            "wrote, or leave the option out"
        ) from error


def digest_of(file: Path) -> str:
    """Return the first digits of a file's SHA-256, by which the card names its table."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12]
