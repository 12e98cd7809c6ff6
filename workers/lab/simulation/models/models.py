"""Models by class of actor."""

from functools import cache
from typing import Final

from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.models.living_models import animals, cyclists, motorcycles, pedestrians
from workers.lab.simulation.models.model import Model
from workers.lab.simulation.models.vehicle_models import buses, cars, trucks, vans


@cache
def models_of(street_class: StreetClass) -> tuple[Model, ...]:
    """Return the models of a class; the first is the plainest.

    Raises:
        KeyError: If no actor has that class.
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
