"""What speaks for an attribution, in words: where, how, and what the witness saw."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.contradiction.evidence import Evidence

FAR: Final = 0.55
"""44 m: a person is 20 points there."""

FEW: Final = 0.4
TURNING: Final = 0.5
HALF: Final = 0.5
SURE: Final = 0.7
MOST_WORDS: Final = 6

MISSED: Final = frozenset({"only_predictive_dynamic", "only_witness_dynamic"})
"""Kinds in which the supervised stream calls static what is seen to move."""

TAKEN_M: Final = 0.3
"""What may be missing of a height: it went with the ground."""

SHAPES: Final = (
    (1.3, 1.3, 0.9, 2.2),
    (2.7, 1.3, 0.9, 2.2),
    (6.5, 2.6, 1.0, 3.2),
    (19.0, 3.2, 2.0, 4.6),
)
"""People, two-wheelers, cars and vans, trucks and buses: the most length and width, the least and
the most height, metres. Of length and width a lidar sees one side or less: they bound from above
alone."""


def fits_no_class(size_m: NDArray[np.float64]) -> bool:
    """Whether a box is too low, too long or too tall for any road user that networks know.

    Args:
        size_m: (3,) length, width and height of what was seen.
    """
    length_m, width_m, height_m = (float(side) for side in size_m)
    return not any(
        length_m <= longest and width_m <= widest and least - TAKEN_M <= height_m <= most
        for longest, widest, least, most in SHAPES
    )


def because_of(kind: str, evidence: Evidence, size_m: NDArray[np.float64]) -> tuple[str, ...]:
    """Say what speaks for an attribution and what made the error likely.

    Args:
        kind: Name of the kind of contradiction.
        evidence: What is known about the track.
        size_m: (3,) length, width and height of its box in the median.
    """
    unasked = 1.0 - evidence.witness_moving - evidence.witness_still
    # a piece of a thing, or one seen badly, has no shape of its own
    whole = evidence.own > SURE and evidence.many_points > HALF and evidence.far < FAR
    missed = kind in MISSED and evidence.supervised_sure > SURE and whole
    said = (
        ("the witness sees it move", evidence.witness_moving > HALF),
        ("the witness sees it stand", evidence.witness_still > HALF),
        ("both see it move right before", evidence.agreed_before > HALF),
        ("both see it move right after", evidence.agreed_after > HALF),
        ("its shape fits no usual class", missed and fits_no_class(size_m)),
        ("occluded before and after", unasked > HALF),
        ("odometry unhealthy", evidence.doubted > 0.0),
        ("much else contradicts alike", evidence.crowded > HALF),
        ("far", evidence.far > FAR),
        ("few points", evidence.many_points < FEW),
        ("at a turn", evidence.turning > TURNING),
        ("low", evidence.low > HALF),
        ("thin", evidence.thin > 0.0),
        ("slow", HALF > evidence.went > 0.2 and evidence.lasting > HALF),
        ("flickers", evidence.steady < 0.8),
    )
    return tuple(words for words, holds in said if holds)[:MOST_WORDS]
