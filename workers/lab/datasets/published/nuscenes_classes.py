"""Categories of nuScenes with their ids in lidarseg, and SemanticKITTI's nearest classes."""

from typing import Final

from workers.lab.datasets.conversion.source import ClassRow

CLASSES: Final = (
    ClassRow(0, "noise", 0, noise=True),
    ClassRow(1, "animal", 0, movable=True),
    ClassRow(2, "human.pedestrian.adult", 6, movable=True, label=30),
    ClassRow(3, "human.pedestrian.child", 6, movable=True, label=30),
    ClassRow(4, "human.pedestrian.construction_worker", 6, movable=True, label=30),
    ClassRow(5, "human.pedestrian.personal_mobility", 6, movable=True, label=30),
    ClassRow(6, "human.pedestrian.police_officer", 6, movable=True, label=30),
    ClassRow(7, "human.pedestrian.stroller", 0, movable=True),
    ClassRow(8, "human.pedestrian.wheelchair", 0, movable=True),
    ClassRow(9, "movable_object.barrier", 0, label=99),
    ClassRow(10, "movable_object.debris", 0, label=99),
    ClassRow(11, "movable_object.pushable_pullable", 0, label=99),
    ClassRow(12, "movable_object.trafficcone", 0, label=99),
    ClassRow(13, "static_object.bicycle_rack", 0, label=99),
    ClassRow(14, "vehicle.bicycle", 2, movable=True, label=11),
    ClassRow(15, "vehicle.bus.bendy", 5, movable=True, label=13),
    ClassRow(16, "vehicle.bus.rigid", 5, movable=True, label=13),
    ClassRow(17, "vehicle.car", 1, movable=True, label=10),
    ClassRow(18, "vehicle.construction", 5, movable=True, label=20),
    ClassRow(19, "vehicle.emergency.ambulance", 5, movable=True, label=20),
    ClassRow(20, "vehicle.emergency.police", 1, movable=True, label=10),
    ClassRow(21, "vehicle.motorcycle", 3, movable=True, label=15),
    ClassRow(22, "vehicle.trailer", 5, movable=True, label=20),
    ClassRow(23, "vehicle.truck", 4, movable=True, label=18),
    ClassRow(24, "flat.driveable_surface", 9, is_ground=True, label=40),
    ClassRow(25, "flat.other", 12, is_ground=True, label=49),
    ClassRow(26, "flat.sidewalk", 11, is_ground=True, label=48),
    ClassRow(27, "flat.terrain", 17, is_ground=True, label=72),
    ClassRow(28, "static.manmade", 13, label=50),
    ClassRow(29, "static.other", 0, label=99),
    ClassRow(30, "static.vegetation", 15, label=70),
    ClassRow(31, "vehicle.ego", 0, noise=True),
)
ID_OF: Final = {row.name: row for row in CLASSES}
