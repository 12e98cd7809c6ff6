"""Street kinds: widths, roadside scenery and speeds of town, suburb, highway and country."""

from dataclasses import dataclass
from typing import Final, Literal

PlaceName = Literal["town", "suburb", "highway", "country"]


@dataclass(frozen=True, slots=True)
class Place:
    """Properties of one kind of street; offsets are from the middle of the road, in metres.

    Attributes:
        name: Name of the kind.
        lanes_m: Lanes of one direction, the inner one first.
        kerb_m: Edge of the carriageway.
        pavement_m: Width of the pavement behind the kerb; 0 none.
        facade_m: Nearest façades; 0 where there are none.
        parking_m: Row of parked vehicles; 0 none.
        cycle_m: Line of cyclists; 0 none.
        block_m: Distance between crossing streets; 0 none.
        cruise_m_per_s: Least and greatest speed of unhindered vehicles.
        marks_m: Lane markings.
        gardens: Whether fences, walls and hedges close off gardens before the houses.
        barriers: Whether guard rails and walls line the road and separate its directions.
        trees_per_100_m: Trees on each side.
        people_per_100_m: Pedestrians on the pavement of each side.
        gap_m: Least and greatest distance between vehicles of one lane.
    """

    name: PlaceName
    lanes_m: tuple[float, ...]
    kerb_m: float
    pavement_m: float
    facade_m: float
    parking_m: float
    cycle_m: float
    block_m: float
    cruise_m_per_s: tuple[float, float]
    marks_m: tuple[float, ...]
    gardens: bool
    barriers: bool
    trees_per_100_m: float
    people_per_100_m: float
    gap_m: tuple[float, float]


PLACES: Final[dict[PlaceName, Place]] = {
    "town": Place(
        name="town",
        lanes_m=(1.8, 5.3),
        kerb_m=9.6,
        pavement_m=8.0,
        facade_m=13.4,
        parking_m=8.5,
        cycle_m=6.9,
        block_m=95.0,
        cruise_m_per_s=(5.0, 12.0),
        marks_m=(0.0, 3.6),
        gardens=False,
        barriers=False,
        trees_per_100_m=5.0,
        people_per_100_m=3.0,
        gap_m=(18.0, 55.0),
    ),
    "suburb": Place(
        name="suburb",
        lanes_m=(1.7,),
        kerb_m=5.9,
        pavement_m=2.4,
        facade_m=13.5,
        parking_m=4.8,
        cycle_m=3.35,
        block_m=120.0,
        cruise_m_per_s=(5.0, 9.0),
        marks_m=(0.0,),
        gardens=True,
        barriers=False,
        trees_per_100_m=9.0,
        people_per_100_m=2.0,
        gap_m=(35.0, 110.0),
    ),
    "highway": Place(
        name="highway",
        lanes_m=(3.4, 7.0, 10.6),
        kerb_m=14.6,
        pavement_m=0.0,
        facade_m=0.0,
        parking_m=0.0,
        cycle_m=0.0,
        block_m=0.0,
        cruise_m_per_s=(20.0, 33.0),
        marks_m=(1.5, 5.2, 8.8, 12.5),
        gardens=False,
        barriers=True,
        trees_per_100_m=6.0,
        people_per_100_m=0.0,
        gap_m=(30.0, 110.0),
    ),
    "country": Place(
        name="country",
        lanes_m=(1.9,),
        kerb_m=3.9,
        pavement_m=0.0,
        facade_m=24.0,
        parking_m=0.0,
        cycle_m=3.3,
        block_m=210.0,
        cruise_m_per_s=(11.0, 23.0),
        marks_m=(0.0, 3.6),
        gardens=True,
        barriers=False,
        trees_per_100_m=14.0,
        people_per_100_m=0.3,
        gap_m=(40.0, 140.0),
    ),
}
