"""Fit who is wrong about a track: `python -m workers.lab.training.attribution --help`.

What it is fitted on is what the benchmark of failures keeps of the logs it mined
(`counterpoint bench failures FLEET --kept DIR`): every contradicting track with its evidence and
who was wrong about it by truth. The table is judged by leaving each log out in turn
(`attribution_scores.py`) and written with its card.
"""

import argparse
import json
import logging
from collections.abc import Mapping, Sequence
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
from workers.lab.evaluation.failures.rows import MinedLog, TrackRow
from workers.lab.training.attribution_prior import PRIOR
from workers.lab.training.attribution_scores import left_out, usable

log = logging.getLogger(__name__)

EXIT_TRANSIENT: Final = 75
REGULARISATION: Final = 0.35
"""How far from the prior a weight is expected to lie: rows are few, evidence overlaps."""

BALANCE: Final = 0.5
"""Rare answers weigh more by this power: 0 as they come, 1 all answers alike."""

_FEW: Final = 10
"""Answers that occur less often than this are not made up for: one track is no rule."""

USED: Final = tuple(name for name in NAMES if name not in ("duration", "point_count"))
"""Length and points are terms of a track's strength already, and say little of who is wrong."""

_DIGITS: Final = 3
_OF_WITNESS: Final = frozenset({ContradictionKind.ONLY_WITNESS_DYNAMIC.value})
_UNWITNESSED: Final = 0.3
"""What a track counts again as it would look without a witness."""

_LEAST: Final = 0.02

Rows = Mapping[str, Any]
"""The rows of one kind, as `attribution.json` has them."""


def main(argv: Sequence[str] | None = None) -> int:
    """Fit, judge and write; exit 0 when done, 1 on bad input, 75 try again."""
    args = _parser().parse_args(argv)
    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    try:
        logs = read_kept(args.kept)
        card = {
            "logs": len(logs),
            "scenes": sum(len(each.scenes) for each in logs),
            "tracks": sum(len(scene.tracks) for each in logs for scene in each.scenes),
            "data": args.data,
            "settings": {"regularisation": REGULARISATION, "balance": BALANCE},
            "left_out": left_out(logs, fit),
        }
        text = json.dumps({"card": card, "kinds": fit(logs)}, indent=1)
        args.out.write_text(text + "\n", encoding="utf-8")
    except CounterpointError as error:
        log.error("%s", error)
        return EXIT_TRANSIENT if isinstance(error, TransientError) else 1
    log.info("%s", json.dumps(card["left_out"], indent=1))
    return 0


def read_kept(folders: Sequence[Path]) -> list[MinedLog]:
    """Read what the benchmark kept, in the order of the names of the logs.

    Raises:
        PermanentError: If there is nothing, or it is of another version.
    """
    logs = []
    for file in sorted(file for folder in folders for file in folder.glob("*.json")):
        try:
            logs.append(MinedLog.model_validate_json(file.read_text(encoding="utf-8")))
        except ValidationError as error:
            raise PermanentError(
                f"{file} is not what this version keeps of a mined log ({error.error_count()} "
                "fields differ); mine it again with `bench failures --kept`"
            ) from error
    if not logs:
        raise PermanentError(f"nothing was kept in {', '.join(map(str, folders))}")
    return sorted(logs, key=lambda each: (each.log_id, each.pipeline_version))


def fit(logs: Sequence[MinedLog]) -> dict[str, Rows]:
    """Fit the tables of all kinds on the tracks of mined logs."""
    tracks = usable(logs)
    return {kind: fit_kind(kind, [each for each in tracks if each.kind == kind]) for kind in PRIOR}


def fit_kind(kind: str, rows: Sequence[TrackRow]) -> dict[str, Any]:
    """Fit the table of one kind: what is most probable after the prior and the rows.

    A multinomial logistic regression whose weights are drawn to those of the prior, not to nothing.

    Args:
        kind: Name of the kind of contradiction.
        rows: Tracks of that kind of which truth knows who was wrong.
    """
    answers, prior = tuple(PRIOR[kind]), _prior_of(kind)
    rows = [*rows, *(_unwitnessed(row) for row in rows if kind not in _OF_WITNESS)]
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


def _unwitnessed(row: TrackRow) -> TrackRow:
    """The same track where no witness is asked: `--witness none` must not be a guess."""
    silent = {"witness_dynamic": 0.0, "witness_static": 0.0}
    return row.model_copy(update={"evidence": {**row.evidence, **silent}})


def _verdict(row: TrackRow) -> Wrong:
    if row.verdict is None:
        raise ValueError("truth does not know who is wrong about this track")
    return row.verdict


def _prior_of(kind: str) -> NDArray[np.float64]:
    """(answers, 1 + evidence) intercepts and weights of the prior."""
    return np.array(
        [
            [intercept, *(weights.get(name, 0.0) for name in USED)]
            for intercept, weights in PRIOR[kind].values()
        ]
    )


def _matrix(rows: Sequence[TrackRow]) -> NDArray[np.float64]:
    return np.array([[1.0, *(row.evidence[name] for name in USED)] for row in rows])


def _weights(rows: Sequence[TrackRow]) -> NDArray[np.float64]:
    """What is worth a look weighs more, and so do rare answers."""
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
        description="Fit who is wrong about a track, on what `bench failures --kept DIR` kept.",
    )
    parser.add_argument("kept", type=Path, nargs="+", help="folders of mined logs")
    parser.add_argument("--data", required=True, help="what was mined, in words")
    parser.add_argument("--out", type=Path, required=True, help="the table, with its card")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
