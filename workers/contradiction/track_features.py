"""Features of a track: named numbers from 0 to 1, the input of attribution."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.contradiction import Instance
from workers.contradiction.tracks import Track


@dataclass(frozen=True, slots=True)
class TrackFeatures:
    """Features of one track; every number is from 0 to 1.

    Attributes:
        witness_dynamic: Share of its points that the witness labels dynamic.
        witness_static: Share of its points that the witness labels static.
        displacement: Straight distance that both ends of its box travelled over the ground; 0.5 at
            one metre. Less where the supervised stream alone labels it dynamic and it stands
            (`standing_ghosts.py`): the box of a ghost slides along the structure.
        straightness: Share of the box's motion that lies along one straight path, the rest is
            jitter. Less for a ghost that stands, and at least `bulk_motion`.
        duration: Time from its first to its last frame; 0.63 at half a second.
        continuity: Share of the frames of its span in which it contradicts.
        point_count: Median points per frame; 0.63 at 25.
        distance: Range over 80 m.
        road_user_size: Plausibility of its box as one of a road user.
        length: Length over 12 m; less by `bulk_motion`.
        height: Height over 3 m.
        thinness: 1 for a box of no width, 0 from 0.4 m on.
        lowness: 1 up to a height of 0.5 m, 0 from 1 m on; fades to 0 at a range of 50 m, since a
            lidar sees too few rows of a distant object to measure its height.
        agreed_before: Share of it that both streams label dynamic, in the best third of a second of
            the first half of its track and of the second before; scaled by `straightness` where
            the supervised stream labels it static, since what stops keeps its dynamic label for a
            while.
        not_refuted_after: Share of it that the supervised stream labels dynamic and the
            self-supervised stream does not label static, in the second half of its track and the
            second after; scaled in the same way.
        dynamic_before: Share of it that the supervised stream labels dynamic earlier, whatever the
            self-supervised stream labels.
        dynamic_after: Share of it that the supervised stream labels dynamic later.
        shape_static: Agreement of its shape with points in the same place 0.5 to 2 s earlier and
            later (`shape_persistence.py`); tested only for lasting tracks with enough points.
        shape_static_after: The same agreement, later only; less by `bulk_motion`, since a lorry
            covers its own shape for seconds.
        arrived: Evidence that its shape was elsewhere before, and that one velocity leads from
            there to here. This and the next two are 0 where its place is hidden or the log ends,
            and for a ghost whose places free space found occupied (`standing_ghosts.py`).
        departed: Evidence that its shape is elsewhere later.
        transits: The smaller of `arrived` and `departed`: an object that only stops or sets off has
            one of both.
        log_end: Nearness of its first frame to the end of the log or shard: 1 up to 0.5 s, where
            setting off cannot be observed, 0 from 1 s on.
        isolation: Share of its surroundings that contradict in the same way.
        supervised_confidence: Mean confidence of the supervised stream.
        selfsupervised_confidence: Mean confidence of the self-supervised stream.
        confirmed: Share of its points whose motion was confirmed more than once; 1 where the stream
            does not report it.
        speed_consistency: Agreement of its path with the measured speed; 0 where none was measured.
        speed: Measured speed over 10 m/s.
        pose_doubted: Share of its frames whose pose is not healthy.
        turn_rate: Turn rate of the sensor; 1 at 0.3 rad/s.
        unobserved: Share of the queried places in its frames that no other frame observed.
        denied_share: Share of all points labelled dynamic around it that the other stream labels
            static.
        agreed_share: Share of these that the other stream labels dynamic too: high at the rim of an
            agreed mover, and 0 where it is too wide or has too many points for a rim (`rims.py`);
            high too for labels bled onto what is behind a mover (`bled_labels.py`).
        unlabelled_share: Share of its points without a label of the self-supervised stream.
        clutter: Count of other contradictions of its kind in its frames; 0.63 at eight.
        rising_ground: Share of the ground around it that rises where no object is
            (`rising_ground.py`); 0 up to 3 %, 1 from 10 % on.
        blind_share: Share of its frames in which the self-supervised stream is blind: at the start
            of a log, after a gap or a lost pose (`blind_moments.py`).
        witness_votes: Frames that vote on the points that the witness labels dynamic, as a share of
            those of a full second before and after; 0 without such points.
        bulk_motion: Thousands of points whose motion is confirmed and measured (`bulk_motion.py`);
            0 up to 500 points per frame, 1 from 2,000 on.
        label_time: Time for which the supervised stream alone labels it dynamic, also up to a
            second before and after its track; 0 up to a quarter of a second, 1 from half a second
            on, and 1 for other kinds (`flashes.py`).
    """

    witness_dynamic: float
    witness_static: float
    displacement: float
    straightness: float
    duration: float
    continuity: float
    point_count: float
    distance: float
    road_user_size: float
    length: float
    height: float
    thinness: float
    lowness: float
    agreed_before: float
    not_refuted_after: float
    dynamic_before: float
    dynamic_after: float
    shape_static: float
    shape_static_after: float
    arrived: float
    departed: float
    transits: float
    log_end: float
    isolation: float
    supervised_confidence: float
    selfsupervised_confidence: float
    confirmed: float
    speed_consistency: float
    speed: float
    pose_doubted: float
    turn_rate: float
    unobserved: float
    denied_share: float
    agreed_share: float
    unlabelled_share: float
    clutter: float
    rising_ground: float
    blind_share: float
    witness_votes: float
    bulk_motion: float
    label_time: float

    def named(self) -> dict[str, float]:
        """Return all of them by name, rounded to 4 digits."""
        return {name: round(float(getattr(self, name)), 4) for name in NAMES}


NAMES: Final = tuple(field.name for field in fields(TrackFeatures))


@dataclass(frozen=True, slots=True, eq=False)
class DescribedTrack:
    """A track with its instances, its box and its features.

    Attributes:
        track: The track.
        members: Its instances, in the order of their frames.
        size_m: (3,) median length, width and height.
        features: Its features.
    """

    track: Track
    members: Sequence[Instance]
    size_m: NDArray[np.float64]
    features: TrackFeatures

    @property
    def points(self) -> NDArray[np.int64]:
        """Number of points of each instance, (len(members),)."""
        return np.array([len(member.point_index) for member in self.members])

    @property
    def is_motion(self) -> bool:
        """True if the self-supervised stream or the witness labels it dynamic."""
        return self.track.kind.measured or self.track.kind.of_witness
