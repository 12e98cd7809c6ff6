"""Fit who is wrong about a track: `python -m workers.training.attribution --help`.

Two steps, so that mining, which takes long, is done once: `collect` mines logs that have truth and
writes a row for every contradicting track; `fit` makes the table of such rows, judges it by leaving
each log out in turn, and writes it with its card.
"""

import argparse
import json
import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from schemas.attribution import Wrong
from schemas.bucket import open_bucket
from schemas.contradiction import ContradictionKind
from schemas.errors import CounterpointError, TransientError
from schemas.mining import MiningSettings
from schemas.recordings import group_recordings
from workers.contradiction.attribution import Table, chances, table_of
from workers.contradiction.evidence import NAMES
from workers.evaluation.attributed import TrackRow, rows_of_log
from workers.training.attribution_prior import PRIOR

log = logging.getLogger(__name__)

EXIT_TRANSIENT: Final = 75
REGULARISATION: Final = 2.0
"""How far from the prior a weight is expected to lie: rows are few, evidence overlaps."""

MIN_FRAMES: Final = 3
BALANCE: Final = 0.75
"""Rare answers weigh more by this power: 0 as they come, 1 all answers alike."""

USED: Final = tuple(name for name in NAMES if name not in ("lasting", "many_points"))
"""Length and points are terms of a track's strength already, and say little of who is wrong."""

_DIGITS: Final = 3
_OF_WITNESS: Final = frozenset({ContradictionKind.ONLY_WITNESS_DYNAMIC.value})
_UNWITNESSED: Final = 0.3
"""What a track counts again as it would look without a witness."""

_LEAST: Final = 0.02


def main(argv: Sequence[str] | None = None) -> int:
    """Collect or fit; exit 0 when done, 1 on bad input, 75 try again."""
    args = _parser().parse_args(argv)
    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    try:
        if args.step == "collect":
            _collect(args)
        else:
            _fit(args)
    except CounterpointError as error:
        log.error("%s", error)
        return EXIT_TRANSIENT if isinstance(error, TransientError) else 1
    return 0


def _collect(args: argparse.Namespace) -> None:
    settings = MiningSettings(bucket=args.bucket, artifacts="memory://", supervised=args.supervised)
    bucket = open_bucket(args.bucket)
    with args.out.open("a", encoding="utf-8") as out:
        for recording in group_recordings(bucket.list()):
            count = 0
            for row in rows_of_log(bucket, recording, settings, truth=args.truth):
                out.write(row.model_dump_json() + "\n")
                count += 1
            log.info("%s: %d tracks", recording.log_id, count)


def _fit(args: argparse.Namespace) -> None:
    rows = list(_read(args.rows))
    kinds = {kind: fit(kind, [row for row in rows if row.kind == kind]) for kind in PRIOR}
    card = {
        "rows": len(rows),
        "logs": len({row.log_id for row in rows}),
        "data": args.data,
        "command": f"python -m workers.training.attribution fit ROWS --data {args.data!r}",
        "settings": {
            "regularisation": REGULARISATION,
            "balance": BALANCE,
            "min_frames": MIN_FRAMES,
        },
        "left_out": {
            kind: judge(kind, [row for row in rows if row.kind == kind]) for kind in kinds
        },
    }
    args.out.write_text(json.dumps({"card": card, "kinds": kinds}, indent=1) + "\n")
    log.info("%s", json.dumps(card["left_out"], indent=1))


def fit(kind: str, rows: Sequence[TrackRow]) -> dict[str, Any]:
    """Fit the table of one kind: what is most probable after the prior and the rows.

    A multinomial logistic regression whose weights are drawn to those of the prior, not to nothing.

    Args:
        kind: Name of the kind of contradiction.
        rows: Tracks of that kind.
    """
    answers, prior = tuple(PRIOR[kind]), _prior_of(kind)
    rows = _usable(rows)
    rows += [_unwitnessed(row) for row in rows if kind not in _OF_WITNESS]
    if rows:
        seen = _matrix(rows)
        true = np.eye(len(answers))[[answers.index(row.wrong) for row in rows]]
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
    silent = {"witness_moving": 0.0, "witness_still": 0.0}
    return row.model_copy(update={"evidence": {**row.evidence, **silent}})


def _prior_of(kind: str) -> NDArray[np.float64]:
    """(answers, 1 + evidence) intercepts and weights of the prior."""
    return np.array(
        [
            [intercept, *(weights.get(name, 0.0) for name in USED)]
            for intercept, weights in PRIOR[kind].values()
        ]
    )


def judge(kind: str, rows: Sequence[TrackRow]) -> dict[str, Any]:
    """Judge by leaving one log out in turn: recall of each answer, and their mean."""
    rows = _usable(rows)
    said: list[Wrong] = []
    true: list[Wrong] = []
    for left_out in sorted({row.log_id for row in rows}):
        table = table_of(fit(kind, [row for row in rows if row.log_id != left_out]))
        mine = [row for row in rows if row.log_id == left_out]
        said += [_likeliest(table, row) for row in mine]
        true += [row.wrong for row in mine]
    recall = {
        answer.value: round(
            float(np.mean([s is answer for s, t in zip(said, true, strict=True) if t is answer])), 3
        )
        for answer in sorted(set(true))
    }
    return {
        "tracks": {answer.value: true.count(answer) for answer in sorted(set(true))},
        "recall": recall,
        "balanced_accuracy": round(float(np.mean(list(recall.values()))), 3) if recall else None,
    }


def _likeliest(table: Table, row: TrackRow) -> Wrong:
    known = chances(table, row.evidence)
    return max(Wrong, key=lambda wrong: known[wrong])


def _usable(rows: Iterable[TrackRow]) -> list[TrackRow]:
    return [row for row in rows if row.frames >= MIN_FRAMES]


def _matrix(rows: Sequence[TrackRow]) -> NDArray[np.float64]:
    return np.array([[1.0, *(row.evidence[name] for name in USED)] for row in rows])


def _weights(rows: Sequence[TrackRow]) -> NDArray[np.float64]:
    """What is worth a look weighs more, and so do rare answers."""
    counts = {answer: sum(row.wrong is answer for row in rows) for answer in Wrong}
    worth = [row.evidence["lasting"] * row.evidence["many_points"] + 0.05 for row in rows]
    rare = [(len(rows) / counts[row.wrong]) ** BALANCE for row in rows]
    asked = [
        1.0 if row.evidence["witness_moving"] + row.evidence["witness_still"] else _UNWITNESSED
        for row in rows
    ]
    weights: NDArray[np.float64] = np.array(worth) * np.array(rare) * np.array(asked)
    return weights


def _read(files: Iterable[Path]) -> Iterator[TrackRow]:
    for file in files:
        for line in file.read_text(encoding="utf-8").splitlines():
            yield TrackRow.model_validate_json(line)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m workers.training.attribution")
    steps = parser.add_subparsers(dest="step", required=True)
    collect = steps.add_parser("collect", help="mine logs that have truth; a line for each track")
    collect.add_argument("bucket", help="URL or path of the logs")
    collect.add_argument("--truth", type=Path, required=True, help="folder of their truth")
    collect.add_argument("--supervised", default="recorded", help="supervised stream, by name")
    collect.add_argument("--out", type=Path, required=True, help="lines are added to this file")
    fitting = steps.add_parser("fit", help="make the table of such lines")
    fitting.add_argument("rows", type=Path, nargs="+", help="files that collect wrote")
    fitting.add_argument("--data", required=True, help="what they were collected from, in words")
    fitting.add_argument("--out", type=Path, required=True, help="the table, with its card")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
