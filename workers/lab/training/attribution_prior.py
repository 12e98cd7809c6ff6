"""Prior of the attribution table: weights of the evidence before any truth, in log-odds.

Rows with truth are few and come from a few streets, while these relations are physics:

- An object that the witness sees standing does not move. One that went a metre in a straight line
  does. Where the ground itself rises, the rise of an object proves nothing.
- An object labelled moving by the supervised stream, and not denied by the other one a second
  earlier or later, did not stand in between: it starts or stops.
- Where it goes on and the supervised stream labels it static, that stream is wrong for a while. It
  is also wrong where the witness sees an object move that it labelled moving before.
- An object that came from elsewhere or leaves its place moves, however slowly. One that does both
  while the witness alone sees it move neither stops nor sets off.
- An object labelled moving later was moving before. One that stands from then on has stopped.
- On an object that stays throughout, a label of moving is wrong. At the end of a log, it is unknown
  whether such an object sets off.
- Points at the rim of an object that both streams see moving are its rim, and no stream's error.
"""

from collections.abc import Mapping
from typing import Final

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind

Row = tuple[float, Mapping[str, float]]
"""Intercept and weights, log-odds at full evidence."""

PRIOR: Final[Mapping[str, Mapping[Wrong, Row]]] = {
    ContradictionKind.ONLY_SEMANTIC_DYNAMIC.value: {
        Wrong.SUPERVISED: (
            0.0,
            {"witness_still": 2.5, "denied": 1.0, "steady": 1.0, "stays": 1.0, "log_ends": -1.5},
        ),
        Wrong.SELFSUPERVISED: (
            0.0,
            {
                "witness_moving": 2.0,
                "went": 2.5,
                "straight": 1.0,
                "denied": 1.0,
                "agreed_before": 3.0,
                "undenied_after": 3.0,
                "came": 1.0,
                "leaves": 2.0,
            },
        ),
        Wrong.BOTH: (-4.0, {}),
        Wrong.NEITHER: (
            0.0,
            {
                "agreed": 2.0,
                "denied": -1.5,
                "agreed_before": 3.0,
                "undenied_after": 3.0,
                "came": 1.0,
                "leaves": 2.0,
            },
        ),
    },
    ContradictionKind.ONLY_PREDICTIVE_DYNAMIC.value: {
        Wrong.SUPERVISED: (
            -2.5,
            {
                "witness_moving": 1.5,
                "confirmed": 2.5,
                "speed_fits": 1.0,
                "straight": 1.0,
                "own": 0.5,
                "road_user": 1.0,
                "denied": 1.0,
                "agreed": -2.0,
                "agreed_before": 1.0,
                "undenied_after": 1.0,
                "called_after": 1.0,
                "crowded": -1.0,
            },
        ),
        Wrong.SELFSUPERVISED: (
            0.5,
            {
                "witness_still": 2.0,
                "doubted": 1.5,
                "crowded": 1.5,
                "thin": 1.0,
                "denied": 0.5,
                "stands_after": 2.0,
                "ground_rises": 5.0,
            },
        ),
        Wrong.BOTH: (-4.0, {"agreed": -2.0}),
        Wrong.NEITHER: (0.0, {"agreed": 2.0, "denied": -1.5, "stands_after": 2.0}),
    },
    ContradictionKind.ONLY_WITNESS_DYNAMIC.value: {
        Wrong.SUPERVISED: (
            -4.5,
            {
                "went": 4.0,
                "straight": 1.5,
                "own": 1.0,
                "road_user": 1.0,
                "agreed": -4.0,
                "called_before": 1.0,
                "called_after": 0.5,
                "passes": 1.5,
            },
        ),
        Wrong.SELFSUPERVISED: (-5.0, {}),
        Wrong.BOTH: (
            -4.5,
            {
                "went": 4.0,
                "straight": 1.5,
                "own": 1.0,
                "road_user": 1.0,
                "denied": 1.0,
                "agreed": -4.0,
                "called_before": 1.0,
                "called_after": 0.5,
                "passes": 1.5,
            },
        ),
        Wrong.NEITHER: (
            0.0,
            {"crowded": 2.0, "doubted": 1.5, "stays": 2.0, "ground_rises": 5.0},
        ),
    },
}
