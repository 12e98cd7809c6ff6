"""Every number of this stage, with its unit and the reason for it."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class InstanceSettings:
    """How contradicting points become instances.

    Attributes:
        eps_m: Neighbourhood of DBSCAN, the paper's value (published code: eps 1.0).
        min_points: Points that make a cluster. The paper takes 25; a car at 70 m has 20, so 10 are
            enough here, and the score weighs few points low instead of losing the far field.
        voxel_m: Points this close count as one place with their number as weight, so that a near
            object of 5,000 points does not cost 5,000 neighbourhoods of 1,000. 0: each on its own.
        max_voxels: A frame with more places doubles the voxels, up to `coarsest_voxel_m`: a
            stream that fails on a whole frame costs tenths of a second, not minutes.
        coarsest_voxel_m: Still well below `eps_m`, so that clusters stay the same things.
        around_m: Side of the cells in which an instance's surroundings are counted, three cells
            each way: what lies within about half a metre of a point touches it.
        max_coordinate_m: Points farther out are left aside: no lidar of a car sees so far, and a
            wild return must not stretch the grid of cells.
    """

    eps_m: float = 1.0
    min_points: int = 10
    voxel_m: float = 0.1
    max_voxels: int = 6_000
    coarsest_voxel_m: float = 0.4
    around_m: float = 0.4
    max_coordinate_m: float = 500.0


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """How instances are tied over frames; everything is per second, never per frame.

    Attributes:
        max_miss_s: How long a thing may go unseen and still be the same thing.
        gate_m: How far from its predicted place an instance may lie, size and speed aside: box
            centres of half-seen objects jump by this much.
        gate_per_length: The gate grows with the longest box of the track: when a car comes out from
            behind another, its visible end is half a length from where the other end was last seen.
        max_gate_m: Beyond this two things are two things.
        acceleration_m_per_s2: The gate grows by half of this times the squared gap: what a car
            that brakes hard can do unseen.
        unseen_speed_m_per_s: The gate grows by this times the gap while a thing's speed is not
            known: a pedestrian that the self-supervised stream calls static has none.
        unlike_cost: What a wholly different length costs beside a distance as large as the gate:
            when a thing comes apart behind a pole, the larger part goes on as the track.
        max_speed_m_per_s: Speeds above are errors of association, not of a road user.
    """

    max_miss_s: float = 0.3
    gate_m: float = 0.8
    gate_per_length: float = 0.4
    max_gate_m: float = 4.0
    acceleration_m_per_s2: float = 8.0
    unseen_speed_m_per_s: float = 4.0
    unlike_cost: float = 0.5
    max_speed_m_per_s: float = 45.0


@dataclass(frozen=True, slots=True)
class ScoreSettings:
    """How a track's strength and a scene's score are made; `track_score.py` has the formula.

    Attributes:
        persistence_s: Seen for this long gives 0.63: a flicker of two frames at 10 Hz gives 0.26.
        evidence_points: Median points per frame that give 0.63: the paper's smallest instance.
        low_m: A box whose height or length is below is no road user: half a wheel, a kerb.
        high_m: From here on the box counts in full.
        long_m: Up to this length a box looks like a road user: a truck.
        longest_m: Above it not at all.
        lorry_m: Up to this length a track counts in full: the longest lorries and buses.
        tram_m: Above it nothing: a facade, or half a street after a jump of the odometry.
        flat_share: A box that is near and this high for its length, or higher, counts in full: cars
            are a third as high as long, without their wheels a quarter.
        flattest_share: And so flat counts nothing: a stretch of road, a kerb, a rail.
        tall_m: From this height on a box is not flat, however long: a bus, a tram.
        flat_below_m: Up to this height it is as flat as its length makes it.
        rows_m_per_m: What may be missing of a height for each metre of range: two rows of beams
            of a common lidar.
        slow_m_per_s: Above it a measured speed counts in full: 4 km/h, the paper's threshold.
        unmeasured: Stands for motion when no speed was measured or the track is too short to
            compare its path with its speed.
        path_error_m_per_s: How far the path of the box may be from the measured velocity.
        path_error_share: And this much more per m/s.
        implausible: What remains of a track whose path says counterfactual.
        decay: Each further track counts this much less than the one before.
        degraded_weight: What a frame with a degraded pose counts; a lost one counts nothing.
        lost_below: Below this mean weight of its frames a scene is `odometry_lost`.
    """

    persistence_s: float = 0.5
    evidence_points: float = 25.0
    low_m: float = 0.2
    high_m: float = 0.5
    long_m: float = 12.0
    longest_m: float = 20.0
    lorry_m: float = 18.75
    tram_m: float = 30.0
    flat_share: float = 0.25
    flattest_share: float = 0.1
    tall_m: float = 1.5
    flat_below_m: float = 1.0
    rows_m_per_m: float = 0.02
    slow_m_per_s: float = 1.1
    unmeasured: float = 0.5
    path_error_m_per_s: float = 1.0
    path_error_share: float = 0.3
    implausible: float = 0.1
    decay: float = 0.5
    degraded_weight: float = 0.5
    lost_below: float = 0.5


DEFAULT_INSTANCES: Final = InstanceSettings()
PAPER_INSTANCES: Final = InstanceSettings(min_points=25, voxel_m=0.0)
"""The published numbers, point by point; a cluster whose border points went elsewhere stays."""

DEFAULT_TRACKS: Final = TrackSettings()
DEFAULT_SCORE: Final = ScoreSettings()
