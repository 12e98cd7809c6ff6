"""Fits the attribution table: `python -m workers.lab.training.attribution --help`.

Training data are the mined logs in the cache of the failure benchmark (`counterpoint bench failures
FLEET --kept DIR`): every contradicting track with its evidence and its true verdict. The table is
evaluated by leave-one-log-out cross-validation (`attribution_scores.py`) and written with its card,
next to the figures of the shipped table on the same tracks. `--update` starts from an earlier table
instead of the prior written by hand, so that what other logs taught is kept.
"""

import argparse
import json
import logging
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.optimize import minimize
from scipy.special import logsumexp

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind
from schemas.errors import CounterpointError, PermanentError, TransientError
from workers.contradiction.track_features import NAMES
from workers.lab.evaluation.failures.attribution import is_evaluated
from workers.lab.evaluation.failures.rows import MinedLog, TrackRow
from workers.lab.training.attribution_prior import PRIOR, Row
from workers.lab.training.attribution_scores import leave_one_log_out, usable_tracks
from workers.lab.training.attribution_tables import Prior, Rows, digest_of, read_table, shipped_rows

log = logging.getLogger(__name__)

EXIT_TRANSIENT: Final = 75
REGULARISATION: Final = 0.35
"""Prior standard deviation of a weight, log-odds: rows are few, evidence overlaps."""

BALANCE: Final = 0.5
"""Exponent that weighs rare verdicts up: 0 for the observed frequencies, 1 for equal weights."""

_FEW: Final = 10
"""Count added to each verdict's frequency, so that a few rare tracks do not dominate."""

USED: Final = tuple(n for n in NAMES if n not in ("duration", "point_count", "label_time"))
"""Evidence of the fit: the features left out are already terms of a track's strength."""

MIN_VERDICTS: Final = 20
"""Long and large tracks of a second verdict below which the table of a kind stays the prior.

A handful of rare tracks describes their streets, not their verdict.
"""

_DIGITS: Final = 3
_OF_WITNESS: Final = frozenset({ContradictionKind.ONLY_WITNESS_DYNAMIC.value})
_UNWITNESSED: Final = 0.3
"""Weight of a track whose witness evidence is removed."""

_LEAST: Final = 0.02


KINDS: Final = tuple(PRIOR)
"""Kinds of contradictions that have a table."""


def main(argv: Sequence[str] | None = None) -> int:
    """Fit, evaluate and write; exit 0 when done, 1 on bad input, 75 try again."""
    args = _parser().parse_args(argv)
    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    try:
        logs = read_mined_logs(args.kept)
        prior = PRIOR if args.update is None else read_table(args.update)
        known = {name for each in usable_tracks(logs) for name in each.evidence}

        def fit_on(some: Sequence[MinedLog]) -> dict[str, Rows]:
            return fit(some, prior, args.kinds)

        card = {
            "logs": len(logs),
            "scenes": sum(len(each.scenes) for each in logs),
            "tracks": sum(len(scene.tracks) for each in logs for scene in each.scenes),
            "data": args.data,
            "settings": {
                "regularisation": REGULARISATION,
                "balance": BALANCE,
                "min_verdicts": MIN_VERDICTS,
            },
            "kinds": args.kinds,
            "started_from": "prior" if args.update is None else digest_of(args.update),
            "features_of_the_prior_only": [name for name in USED if name not in known],
            "left_out": leave_one_log_out(logs, fit_on),
            "shipped_before": leave_one_log_out(logs, lambda _: shipped_rows()),
        }
        text = json.dumps({"card": card, "kinds": fit_on(logs)}, indent=1)
        args.out.write_text(text + "\n", encoding="utf-8")
    except CounterpointError as error:
        log.error("%s", error)
        return EXIT_TRANSIENT if isinstance(error, TransientError) else 1
    log.info("%s", json.dumps({key: card[key] for key in ("shipped_before", "left_out")}, indent=1))
    return 0


def read_mined_logs(folders: Sequence[Path]) -> list[MinedLog]:
    """Read the cached results of the benchmark, in the order of the names of the logs.

    Raises:
        PermanentError: If there are none, or they are of another version.
    """
    logs = []
    for file in sorted(file for folder in folders for file in folder.glob("*.json")):
        try:
            logs.append(MinedLog.model_validate_json(file.read_text(encoding="utf-8")))
        except ValidationError as error:
            raise PermanentError(
                f"{file} is no mined log of this version ({error.error_count()} "
                "fields differ); mine it again with `bench failures --kept`"
            ) from error
    if not logs:
        raise PermanentError(f"no mined logs in {', '.join(map(str, folders))}")
    return sorted(logs, key=lambda each: (each.log_id, each.pipeline_version))


def fit(
    logs: Sequence[MinedLog], prior: Prior = PRIOR, kinds: Collection[str] = KINDS
) -> dict[str, Rows]:
    """Fit the tables of some kinds on the tracks of mined logs; the others stay the prior."""
    tracks = usable_tracks(logs)
    return {
        kind: fit_kind(
            kind, [each for each in tracks if each.kind == kind and kind in kinds], prior
        )
        for kind in PRIOR
    }


def fit_kind(kind: str, rows: Sequence[TrackRow], prior_rows: Prior = PRIOR) -> dict[str, Any]:
    """Fit the table of one kind: the maximum a posteriori weights of prior and rows.

    The model is a multinomial logistic regression whose weights are regularised towards the prior
    instead of zero.

    Args:
        kind: Name of the kind of contradiction.
        rows: Tracks of that kind with a true verdict.
        prior_rows: Intercepts and weights of the prior, by kind and verdict.
    """
    answers, prior = tuple(prior_rows[kind]), _prior_of(prior_rows[kind])
    if not _is_enough(rows):
        rows = []
    rows = [*rows, *(_without_witness(row) for row in rows if kind not in _OF_WITNESS)]
    if rows:
        seen = _matrix(rows)
        true = np.eye(len(answers))[[answers.index(_verdict(row)) for row in rows]]
        weights = _weights(rows)

        def loss(flat: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
            table = flat.reshape(prior.shape)
            odds = seen @ table.T
            logs = odds - logsumexp(odds, axis=1, keepdims=True)
            gap = (np.exp(logs) - true) * weights[:, None]
            away = (table - prior) / REGULARISATION
            total = -float((weights[:, None] * true * logs).sum()) + float((away**2).sum()) / 2
            return total, (gap.T @ seen + away / REGULARISATION).ravel()

        found = minimize(loss, prior.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 500})
        table = np.asarray(found.x).reshape(prior.shape)
    else:
        table = prior
    return {
        answer.value: {
            "intercept": round(float(line[0]), _DIGITS),
            "weights": {
                name: round(float(weight), _DIGITS)
                for name, weight in zip(USED, line[1:], strict=True)
                if abs(weight) >= _LEAST
            },
        }
        for answer, line in zip(answers, table, strict=True)
    }


def _is_enough(rows: Sequence[TrackRow]) -> bool:
    """Test that two verdicts are common among the tracks on which a table is evaluated."""
    counts = Counter(row.verdict for row in rows if is_evaluated(row))
    return sum(count >= MIN_VERDICTS for count in counts.values()) > 1


def _without_witness(row: TrackRow) -> TrackRow:
    """Copy a track without witness evidence, so that the fit covers `--witness none`."""
    silent = {"witness_dynamic": 0.0, "witness_static": 0.0}
    return row.model_copy(update={"evidence": {**row.evidence, **silent}})


def _verdict(row: TrackRow) -> Wrong:
    if row.verdict is None:
        raise ValueError("this track has no true verdict")
    return row.verdict


def _prior_of(rows: Mapping[Wrong, Row]) -> NDArray[np.float64]:
    """(answers, 1 + evidence) intercepts and weights of the prior."""
    return np.array(
        [
            [intercept, *(weights.get(name, 0.0) for name in USED)]
            for intercept, weights in rows.values()
        ]
    )


def _matrix(rows: Sequence[TrackRow]) -> NDArray[np.float64]:
    """Return (rows, 1 + evidence); evidence that a row was mined without is 0."""
    return np.array([[1.0, *(row.evidence.get(name, 0.0) for name in USED)] for row in rows])


def _weights(rows: Sequence[TrackRow]) -> NDArray[np.float64]:
    """Weigh rows by duration, size and rarity of their verdict."""
    counts = {answer: sum(row.verdict is answer for row in rows) for answer in Wrong}
    worth = [row.evidence["duration"] * row.evidence["point_count"] + 0.05 for row in rows]
    rare = [(len(rows) / (counts[_verdict(row)] + _FEW)) ** BALANCE for row in rows]
    asked = [
        1.0 if row.evidence["witness_dynamic"] + row.evidence["witness_static"] else _UNWITNESSED
        for row in rows
    ]
    weights: NDArray[np.float64] = np.array(worth) * np.array(rare) * np.array(asked)
    return weights


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m workers.lab.training.attribution",
        description="Fit the attribution table on results of `bench failures --kept DIR`.",
    )
    parser.add_argument("kept", type=Path, nargs="+", help="folders of mined logs")
    parser.add_argument("--update", type=Path, help="table to start from instead of the prior")
    parser.add_argument(
        "--kinds", nargs="+", choices=KINDS, default=[*KINDS], help="kinds to fit; default: all"
    )
    parser.add_argument("--data", required=True, help="description of the mined data")
    parser.add_argument("--out", type=Path, required=True, help="the table, with its card")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
