"""Settings of this stage: every number with its unit and the reason for it."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class InstanceSettings:
    """Settings of instance clustering.

    Attributes:
        eps_m: Neighbourhood radius of DBSCAN, the paper's value (published code: eps 1.0).
        min_points: Points of a core neighbourhood. The paper takes 25, but a car at 70 m has 20.
            With 10 the far field is kept, and the score gives few points a low weight.
        voxel_m: Edge of the voxels whose points are merged to one place, with their number as
            weight. A near object of 5,000 points then does not cost 5,000 neighbourhoods of 1,000.
            0: no points are merged.
        max_voxels: Number of places above which voxels are doubled, up to `coarsest_voxel_m`: a
            stream that fails on a whole frame costs tenths of a second, not minutes.
        coarsest_voxel_m: Largest edge of a voxel, well below `eps_m`, so that clusters keep their
            extent.
        around_m: Side of the cells in which the points around an instance are counted. The block
            has three cells each way: a point within about half a metre touches the instance.
        rim_m: Side of the cells in which agreed points next to an instance are sought. The block
            has three cells each way: bled labels reach about half a metre from a mover.
        max_coordinate_m: Largest coordinate of a point that is clustered: no lidar of a car
            measures as far, and a wild return must not extend the grid of cells.
    """

    eps_m: float = 1.0
    min_points: int = 10
    voxel_m: float = 0.1
    max_voxels: int = 6_000
    coarsest_voxel_m: float = 0.4
    around_m: float = 0.4
    rim_m: float = 0.4
    max_coordinate_m: float = 500.0


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """Settings of track association; every number is per second, never per frame.

    Attributes:
        max_miss_s: Longest time that an object may be unobserved within one track.
        gate_m: Constant part of the gate, the greatest distance from the predicted place: box
            centres of partly observed objects jump by as much.
        gate_per_length: Growth of the gate per metre of the track's longest box. When a car comes
            out from behind another, its visible end is half a length from the end observed last.
        max_gate_m: Upper bound of the gate: beyond it two instances are two objects.
        acceleration_m_per_s2: Acceleration that widens the gate by half of it times the squared
            gap, as for a car that brakes hard while unobserved.
        unseen_speed_m_per_s: Speed that widens the gate by its product with the gap while the
            speed of the track is unknown. No speed is measured for a pedestrian that the
            self-supervised stream labels static.
        unlike_cost: Cost of a completely different length, where a distance of one gate costs 1.
            When an object splits behind a pole, the larger part continues the track.
        max_speed_m_per_s: Largest speed of a track: higher ones are errors of association.
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
class FeatureSettings:
    """Settings of the features of a track and of its size and motion, which overlays keep.

    Attributes:
        persistence_s: Time for a persistence of 0.63; a flicker of two frames at 10 Hz has 0.26.
        evidence_points: Median points per frame for a factor of 0.63: the paper's smallest
            instance.
        low_m: Height or length of a box up to which its plausibility is 0: half a wheel, a kerb.
        high_m: Height and length from which on its plausibility is not reduced.
        long_m: Length up to which a box is plausible as a road user: a truck.
        longest_m: Length from which on its plausibility is 0.
        lorry_m: Length of a track up to which it counts in full: the longest lorries and buses.
        tram_m: Length from which on it counts 0: a facade, or half a street after a jump of the
            odometry.
        flat_share: Height over length from which on a near box counts in full. Cars have a third,
            and a quarter without their wheels.
        flattest_share: Height over length up to which it counts 0: a stretch of road, a kerb, a
            rail.
        tall_m: Height from which on a box of any length is not flat: a bus, a tram.
        flat_below_m: Height up to which flatness depends on height over length alone.
        rows_m_per_m: Height that may be unobserved per metre of range: two rows of beams of a
            common lidar.
        slow_m_per_s: Measured speed from which on motion counts in full: 4 km/h, the paper's
            threshold.
        unmeasured: Agreement with the measured speed when none was measured. For a track too short
            to compare its path it is averaged with 1.
        path_error_m_per_s: Tolerance between the velocity of the box and the measured one.
        path_error_share: Growth of this tolerance per m/s of speed.
        implausible: Lower bound of the agreement, for a path that contradicts the measured speed.
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


DEFAULT_INSTANCES: Final = InstanceSettings()
PAPER_INSTANCES: Final = InstanceSettings(min_points=25, voxel_m=0.0)
"""The published numbers, without voxels; a cluster that lost border points to another is kept."""

DEFAULT_TRACKS: Final = TrackSettings()
DEFAULT_FEATURES: Final = FeatureSettings()
