"""Classes of points in PandaSet, with the class of SemanticKITTI that each one is nearest to."""

from typing import Final

import numpy as np

from workers.lab.datasets.conversion.source import ClassRow

CLASSES: Final = (
    ClassRow(1, "Smoke", 0, noise=True),
    ClassRow(2, "Exhaust", 0, noise=True),
    ClassRow(3, "Spray or rain", 0, noise=True),
    ClassRow(4, "Reflection", 0, noise=True),
    ClassRow(5, "Vegetation", 15, label=70),
    ClassRow(6, "Ground", 17, is_ground=True, label=72),
    ClassRow(7, "Road", 9, is_ground=True, label=40),
    ClassRow(8, "Lane Line Marking", 9, is_ground=True, label=40),
    ClassRow(9, "Stop Line Marking", 9, is_ground=True, label=40),
    ClassRow(10, "Other Road Marking", 9, is_ground=True, label=40),
    ClassRow(11, "Sidewalk", 11, is_ground=True, label=48),
    ClassRow(12, "Driveway", 12, is_ground=True, label=49),
    ClassRow(13, "Car", 1, movable=True, label=10),
    ClassRow(14, "Pickup Truck", 4, movable=True, label=18),
    ClassRow(15, "Medium-sized Truck", 4, movable=True, label=18),
    ClassRow(16, "Semi-truck", 4, movable=True, label=18),
    ClassRow(17, "Towed Object", 5, movable=True, label=20),
    ClassRow(18, "Motorcycle", 3, movable=True, label=15),
    ClassRow(19, "Other Vehicle - Construction Vehicle", 5, movable=True, label=20),
    ClassRow(20, "Other Vehicle - Uncommon", 5, movable=True, label=20),
    ClassRow(21, "Other Vehicle - Pedicab", 5, movable=True, label=20),
    ClassRow(22, "Emergency Vehicle", 5, movable=True, label=20),
    ClassRow(23, "Bus", 5, movable=True, label=20),
    ClassRow(24, "Personal Mobility Device", 0, movable=True),
    ClassRow(25, "Motorized Scooter", 3, movable=True, label=15),
    ClassRow(26, "Bicycle", 2, movable=True, label=11),
    ClassRow(27, "Train", 5, movable=True, label=20),
    ClassRow(28, "Trolley", 5, movable=True, label=20),
    ClassRow(29, "Tram / Subway", 5, movable=True, label=20),
    ClassRow(30, "Pedestrian", 6, movable=True, label=30),
    ClassRow(31, "Pedestrian with Object", 6, movable=True, label=30),
    ClassRow(32, "Animals - Bird", 0, movable=True),
    ClassRow(33, "Animals - Other", 0, movable=True),
    ClassRow(34, "Pylons", 0, label=99),
    ClassRow(35, "Road Barriers", 14, label=51),
    ClassRow(36, "Signs", 19, label=81),
    ClassRow(37, "Cones", 0, label=99),
    ClassRow(38, "Construction Signs", 0, label=99),
    ClassRow(39, "Temporary Construction Barriers", 0, label=99),
    ClassRow(40, "Rolling Containers", 0, label=99),
    ClassRow(41, "Building", 13, label=50),
    ClassRow(42, "Other Static Object", 0, label=99),
)

STATIC_LABELS: Final = np.zeros(256, np.uint32)
"""Id in a `.label` file of each class; files of labels have no motion."""

STATIC_LABELS[[each.class_id for each in CLASSES]] = [each.label for each in CLASSES]
