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
            {
                "witness_static": 2.5,
                "denied_share": 1.0,
                "continuity": 1.0,
                "shape_static": 1.0,
                "log_end": -1.5,
            },
        ),
        Wrong.SELFSUPERVISED: (
            0.0,
            {
                "witness_dynamic": 2.0,
                "displacement": 2.5,
                "straightness": 1.0,
                "denied_share": 1.0,
                "agreed_before": 3.0,
                "not_refuted_after": 3.0,
                "arrived": 1.0,
                "departed": 2.0,
            },
        ),
        Wrong.BOTH: (-4.0, {}),
        Wrong.NEITHER: (
            0.0,
            {
                "agreed_share": 2.0,
                "denied_share": -1.5,
                "agreed_before": 3.0,
                "not_refuted_after": 3.0,
                "arrived": 1.0,
                "departed": 2.0,
            },
        ),
    },
    ContradictionKind.ONLY_PREDICTIVE_DYNAMIC.value: {
        Wrong.SUPERVISED: (
            -2.5,
            {
                "witness_dynamic": 1.5,
                "confirmed": 2.5,
                "speed_consistency": 1.0,
                "straightness": 1.0,
                "isolation": 0.5,
                "road_user_size": 1.0,
                "denied_share": 1.0,
                "agreed_share": -2.0,
                "agreed_before": 1.0,
                "not_refuted_after": 1.0,
                "dynamic_after": 1.0,
                "clutter": -1.0,
            },
        ),
        Wrong.SELFSUPERVISED: (
            0.5,
            {
                "witness_static": 2.0,
                "pose_doubted": 1.5,
                "clutter": 1.5,
                "thinness": 1.0,
                "denied_share": 0.5,
                "shape_static_after": 2.0,
                "rising_ground": 5.0,
            },
        ),
        Wrong.BOTH: (-4.0, {"agreed_share": -2.0}),
        Wrong.NEITHER: (
            0.0,
            {"agreed_share": 2.0, "denied_share": -1.5, "shape_static_after": 2.0},
        ),
    },
    ContradictionKind.ONLY_WITNESS_DYNAMIC.value: {
        Wrong.SUPERVISED: (
            -4.5,
            {
                "displacement": 4.0,
                "straightness": 1.5,
                "isolation": 1.0,
                "road_user_size": 1.0,
                "agreed_share": -4.0,
                "dynamic_before": 1.0,
                "dynamic_after": 0.5,
                "transits": 1.5,
            },
        ),
        Wrong.SELFSUPERVISED: (-5.0, {}),
        Wrong.BOTH: (
            -4.5,
            {
                "displacement": 4.0,
                "straightness": 1.5,
                "isolation": 1.0,
                "road_user_size": 1.0,
                "denied_share": 1.0,
                "agreed_share": -4.0,
                "dynamic_before": 1.0,
                "dynamic_after": 0.5,
                "transits": 1.5,
            },
        ),
        Wrong.NEITHER: (
            0.0,
            {"clutter": 2.0, "pose_doubted": 1.5, "shape_static": 2.0, "rising_ground": 5.0},
        ),
    },
}
