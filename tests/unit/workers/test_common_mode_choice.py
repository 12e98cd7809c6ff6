import numpy as np
from numpy.typing import NDArray

from workers.simulation.anew import places_anew
from workers.simulation.candidates import candidates_of, look_at
from workers.simulation.kinds import StreetClass
from workers.simulation.lidar import UNEVEN_64, Lidar, SimulatedFrame, sweep
from workers.simulation.plan import FailureKind, LogPlan, PlannedFailure
from workers.simulation.planting import plant
from workers.simulation.street_plan import StreetPlan
from workers.simulation.worlds import build_street

EGO_M_PER_S = 8.0
SPAN_S = 2.0


def body(size_m: tuple[float, float, float], at_m: tuple[float, float]) -> NDArray[np.float64]:
    """Points of a box, one every decimetre, its middle at a place."""
    along, aside, up = (np.arange(0.05, side, 0.1) for side in size_m)
    x, y, z = (each.ravel() for each in np.meshgrid(along, aside, up))
    return np.stack([x - size_m[0] / 2 + at_m[0], y - size_m[1] / 2 + at_m[1], z - 1.5], axis=1)


def passing(
    size_m: tuple[float, float, float], m_per_s: float, *, wall_m: float | None = None
) -> list[SimulatedFrame]:
    """See a box go along x at y = 6 from a car that drives, beside a wall at some y."""
    frames = []
    for index in range(0, round(SPAN_S / 0.1), 2):
        time_s = 0.1 * index
        thing = body(size_m, (m_per_s * time_s, 6.0))
        wall = np.zeros((0, 3)) if wall_m is None else body((12.0, 0.1, 2.0), (0.0, wall_m))
        points = np.concatenate([thing, wall])
        mine = np.arange(len(points)) < len(thing)
        late_s = np.where(points[:, 0] > 0, 0.0, 0.09)  # where the lidar looks to at last
        points[mine, 0] += m_per_s * late_s[mine]
        points[:, 0] -= EGO_M_PER_S * (time_s + late_s)
        pose = np.eye(4)
        pose[0, 3] = EGO_M_PER_S * time_s
        count = len(points)
        frames.append(
            SimulatedFrame(
                index=index,
                time_s=time_s,
                points_m=points.astype(np.float32),
                intensity=np.zeros(count, np.float32),
                offset_ns=(late_s * 1e9).astype(np.uint32),
                ring=np.zeros(count, np.uint16),
                class_id=np.full(count, StreetClass.CAR, np.uint8),
                track=np.where(mine, 0, -1).astype(np.int16),
                motion=np.where(mine, 2, 1).astype(np.uint8),
                ground=np.zeros(count, np.uint8),
                world_from_sensor=pose,
            )
        )
    return frames


def anew(frames: list[SimulatedFrame]) -> float:
    return places_anew(frames, 0, start_s=1.0, lasts_s=1.0)


WALKER = (0.4, 0.5, 1.7)


def test_who_strolls_leaves_less_of_their_own_place_than_who_walks() -> None:
    strolls, walks = anew(passing(WALKER, 0.55)), anew(passing(WALKER, 1.4))
    assert 0 < strolls < 0.8 * walks


def test_who_walks_along_a_wall_takes_fewer_places_that_were_free() -> None:
    alone, along = anew(passing(WALKER, 1.4)), anew(passing(WALKER, 1.4, wall_m=6.3))
    assert along < 0.8 * alone


def test_what_is_long_covers_its_own_place() -> None:
    long, short = (18.5, 0.2, 3.0), (4.6, 0.2, 3.0)
    shares = [anew(passing(size, 6.0)) / (size[0] * size[2]) for size in (long, short)]
    assert shares[0] < 0.5 * shares[1]


def test_what_stands_takes_no_place_anew_however_the_car_drives() -> None:
    assert anew(passing(WALKER, 0.0)) == 0


def test_nothing_is_known_of_a_lone_frame() -> None:
    assert places_anew(passing(WALKER, 1.0)[:1], 0, start_s=0.0, lasts_s=1.0) == np.inf


def test_a_common_mode_failure_takes_the_mover_that_moves_least_plainly() -> None:
    lidar = Lidar(elevation_deg=UNEVEN_64[::2], columns=512)
    street = build_street(6, seconds=4.0, plan=StreetPlan(unsettling=True))
    frames = [sweep(street, lidar, index) for index in range(40)]
    wanted = PlannedFailure(1, FailureKind.MISSED_MOVER, common_mode=True)
    plan = LogPlan(0, 11, 2, hard=False, software_version="2026.1", failures=(wanted,))
    (failure,), _ = plant(street, plan, look=lambda index: frames[index], period_s=0.1)

    view = look_at(street, lambda index: frames[index], from_s=2.0, to_s=4.0, period_s=0.1)
    able = candidates_of(view, FailureKind.MISSED_MOVER, common_mode=True)
    plainly = {
        each.track: places_anew(view.frames, each.track, start_s=each.start_s, lasts_s=each.lasts_s)
        for each in able
        if each.lasts_s >= 0.6
    }
    assert failure.common_mode
    assert failure.because
    assert len(plainly) > 1
    assert plainly[failure.track] == min(plainly.values())
