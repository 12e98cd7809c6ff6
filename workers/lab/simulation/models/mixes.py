"""Frequencies of vehicle classes, in traffic and parked."""

from typing import Final

from workers.lab.simulation.models.kinds import StreetClass

LANE_MIX: Final = (
    (StreetClass.CAR, 0.68),
    (StreetClass.VAN, 0.11),
    (StreetClass.TRUCK, 0.08),
    (StreetClass.BUS, 0.05),
    (StreetClass.MOTORCYCLE, 0.08),
)
PARKED_MIX: Final = (
    (StreetClass.CAR, 0.84),
    (StreetClass.VAN, 0.12),
    (StreetClass.TRUCK, 0.04),
)
