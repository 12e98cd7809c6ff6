"""What is known about one track, as named numbers between 0 and 1: what attribution rests on."""

from dataclasses import dataclass, fields
from typing import Final


@dataclass(frozen=True, slots=True)
class Evidence:
    """Named, bounded numbers; every one is 0 to 1.

    Attributes:
        witness_moving: Share of its points that the witness calls dynamic.
        witness_still: Share of its points that the witness calls static.
        went: How far both its ends went over the ground along a straight line: half at a metre.
        straight: How much of that is a path, and how much the box jumps about.
        lasting: Seconds seen: 0.63 at half a second.
        steady: Share of the frames of its span in which it contradicts.
        many_points: Median points a frame: 0.63 at 25.
        far: Range over 80 m.
        road_user: Whether its box has the size of one.
        long: Length over 12 m.
        tall: Height over 3 m.
        thin: Whether its box is thinner than 0.4 m.
        low: Whether it is lower than a metre: 1 at half of that; near alone, as of what is far a
            lidar sees few rows, and nothing says how high it is: none from 50 m on.
        agreed_before: Share of it that both streams call moving, in the best third of a second of
            the first half of its track and of the second before; of what the supervised stream
            calls static, as far as it goes straight: what stops is remembered as moving for a
            while.
        undenied_after: Share that the supervised stream calls moving and the other one does not
            call static, in its second half and the second after; likewise as far as it goes
            straight.
        called_before: Share of it that the supervised stream calls moving earlier, whatever the
            other one says.
        called_after: And later.
        stays: Its shape lies in the same place half a second to two seconds before and after
            (`shape_persistence.py`); asked of what lasts and has points.
        stands_after: It does after, whatever it did before.
        came: It lay elsewhere before, and one velocity leads from there to here.
        leaves: It lies elsewhere after. All are 0 where it is hidden, or the log ends.
        passes: It came, and leaves: what only stops or sets off does one of both.
        log_ends: It begins so shortly before the end of log or shard that nothing tells whether it
            sets off: 1 up to half a second, none from a second on.
        own: Share of its surroundings that contradict alike.
        supervised_sure: Mean confidence of the supervised stream.
        selfsupervised_sure: Mean confidence of the self-supervised stream.
        confirmed: Share of its points proved to move more than once; 1 where that is not told.
        speed_fits: How well its path bears out the measured speed; 0 where none was measured.
        fast: Measured speed over 10 m/s.
        doubted: Share of its frames whose pose is not healthy.
        turning: How fast the sensor turned: 1 at 0.3 rad/s.
        unseen: Share of the places asked about in its frames that no other frame saw.
        denied: Of all that is called dynamic around it, share that the other stream calls static.
        agreed: And dynamic: the rim of a thing that both see move.
        silent: Share of its points that the self-supervised stream says nothing about.
        crowded: Whether much else contradicts in the same way in its frames: 0.63 at eight.
        ground_rises: How much of the ground around it rises where nothing stands
            (`rising_ground.py`): none up to 3 %, 1 from a tenth on.
    """

    witness_moving: float
    witness_still: float
    went: float
    straight: float
    lasting: float
    steady: float
    many_points: float
    far: float
    road_user: float
    long: float
    tall: float
    thin: float
    low: float
    agreed_before: float
    undenied_after: float
    called_before: float
    called_after: float
    stays: float
    stands_after: float
    came: float
    leaves: float
    passes: float
    log_ends: float
    own: float
    supervised_sure: float
    selfsupervised_sure: float
    confirmed: float
    speed_fits: float
    fast: float
    doubted: float
    turning: float
    unseen: float
    denied: float
    agreed: float
    silent: float
    crowded: float
    ground_rises: float

    def named(self) -> dict[str, float]:
        """All of them by name, rounded."""
        return {name: round(float(getattr(self, name)), 4) for name in NAMES}


NAMES: Final = tuple(field.name for field in fields(Evidence))
