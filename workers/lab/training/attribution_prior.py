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
- Thousands of points whose motion is confirmed and measured move.
- While the self-supervised stream is blind, the witness lacks the frames of one side too, and is
  seldom right alone.
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
                "bulk_motion": 1.5,
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
            {
                "clutter": 2.0,
                "pose_doubted": 1.5,
                "shape_static": 2.0,
                "rising_ground": 5.0,
                "blind_share": 2.0,
            },
        ),
    },
}
