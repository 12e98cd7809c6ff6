"""What each kind of actor looks like."""

from functools import cache
from typing import Final

from workers.simulation.kinds import StreetClass
from workers.simulation.living_models import animals, cyclists, motorcycles, pedestrians
from workers.simulation.model import Model
from workers.simulation.vehicle_models import buses, cars, trucks, vans


@cache
def models_of(street_class: StreetClass) -> tuple[Model, ...]:
    """Give the models of a class; the first is the plainest.

    Raises:
        KeyError: If nothing of that class ever moves.
    """
    return _MAKERS[street_class]()


_MAKERS: Final = {
    StreetClass.CAR: cars,
    StreetClass.VAN: vans,
    StreetClass.TRUCK: trucks,
    StreetClass.BUS: buses,
    StreetClass.PEDESTRIAN: pedestrians,
    StreetClass.CYCLIST: cyclists,
    StreetClass.MOTORCYCLE: motorcycles,
    StreetClass.ANIMAL: animals,
}
