"""What is believed of who is wrong before any truth was seen: what fitting is drawn to.

Rows with truth are few and come from a few streets, while physics is known: what the witness sees
stand does not move, what went a metre in a straight line does, and where the ground itself rises
nothing is proved by what rises with it. What the supervised stream calls moving and the other one
does not deny a second earlier or later did not stand in between: it starts or stops. Or, where it
goes on and the supervised stream calls it static, that stream errs for a while, as it does where
the witness sees move what it called moving itself. What came from elsewhere or leaves its place
moves, however slowly; what does both where the witness alone sees it move, neither stops nor sets
off. What is called moving later as well was moving. What stands from then on has stopped; of what
stays all along, who calls it moving errs; of what is called moving as the log ends nobody has seen
whether it sets off. What lies at the rim of what both see move is that
thing's rim, and nobody's error. Log-odds at full evidence.
"""

from collections.abc import Mapping
from typing import Final

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind

Row = tuple[float, Mapping[str, float]]
"""Intercept and weights."""

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
