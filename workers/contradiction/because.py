"""What speaks for an attribution, in words: where, how, and what the witness saw."""

from typing import Final

from workers.contradiction.evidence import Evidence

FAR: Final = 0.55
"""44 m: a person is 20 points there."""

FEW: Final = 0.4
TURNING: Final = 0.5
HALF: Final = 0.5
MOST_WORDS: Final = 6


def because_of(kind: str, evidence: Evidence) -> tuple[str, ...]:
    """Say what speaks for an attribution and what made the error likely.

    Args:
        kind: Name of the kind of contradiction.
        evidence: What is known about the track.
    """
    unasked = 1.0 - evidence.witness_moving - evidence.witness_still
    said = (
        ("the witness sees it move", evidence.witness_moving > HALF),
        ("the witness sees it stand", evidence.witness_still > HALF),
        ("occluded before and after", unasked > HALF),
        ("odometry unhealthy", evidence.doubted > 0.0),
        ("much else contradicts alike", evidence.crowded > HALF),
        ("far", evidence.far > FAR),
        ("few points", evidence.many_points < FEW),
        ("at a turn", evidence.turning > TURNING),
        ("thin", evidence.thin > 0.0),
        ("slow", HALF > evidence.went > 0.2 and evidence.lasting > HALF),
        ("flickers", evidence.steady < 0.8),
    )
    return tuple(words for words, holds in said if holds)[:MOST_WORDS]
