"""Models of cars, vans, trucks and buses: bodies with windows, wheels, plates and mirrors."""

from itertools import pairwise

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, box, loft
from workers.lab.simulation.models.model import Model, Section, make_model, wheels_at


def _four(front_m: float, rear_m: float, half_track_m: float) -> list[tuple[float, float]]:
    return [(x, y) for x in (front_m, -rear_m) for y in (half_track_m, -half_track_m)]


def _vehicle(
    name: str,
    what: StreetClass,
    *,
    body: list[Section],
    cabin: list[Section],
    wheels: list[tuple[float, float]],
    radius_m: float,
) -> Model:
    tail, nose = body[0], body[-1]
    parts = [
        loft(body, what=what, sides=Material.COLOURED, top=Material.COLOURED),
        loft(cabin, what=what, sides=Material.GLASS, top=Material.GLASS),
        *wheels_at(what, wheels, radius_m, 0.24),
        *_plates(what, nose, tail),
    ]
    roofs = [(a, b) for a, b in pairwise(cabin) if abs(a[4] - b[4]) < 0.05 and a[4] > a[3] + 0.2]
    for (x_0, _, above_0, _, high), (x_1, _, above_1, _, end_high) in roofs:
        roof = [
            (x_0, above_0, above_0, high, high + 0.03),
            (x_1, above_1, above_1, end_high, end_high + 0.03),
        ]
        parts.append(loft(roof, what=what, sides=Material.COLOURED, top=Material.COLOURED))
    mirror_x = cabin[-1][0] - 0.25
    mirrors = [
        box(
            *(0.12, 0.2, cabin[-1][3], cabin[-1][3] + 0.15),
            what=what,
            material=Material.COLOURED,
            x_m=mirror_x,
            y_m=side * (cabin[-1][1] + 0.12),
        )
        for side in (1, -1)
    ]
    return make_model(name, what, [parts], beyond_size=mirrors)


def _plates(what: StreetClass, nose: Section, tail: Section) -> list[Mesh]:
    """Build number plates and lamps, the brightest surfaces of a car."""
    plates = []
    for x, (_, half, _, low, high) in ((nose[0] + 0.01, nose), (tail[0] - 0.01, tail)):
        middle = (low + high) / 2
        plates.append(
            box(0.02, 0.5, middle - 0.06, middle + 0.06, what=what, material=Material.MIRROR, x_m=x)
        )
        plates += [
            box(
                *(0.02, 0.2, high - 0.14, high - 0.02),
                what=what,
                material=Material.MIRROR,
                x_m=x,
                y_m=side * (half - 0.18),
            )
            for side in (1, -1)
        ]
    return plates


def cars() -> tuple[Model, ...]:
    """Return models of cars, the plainest first."""
    car = StreetClass.CAR
    saloon = _vehicle(
        "saloon",
        car,
        body=[
            (-2.25, 0.72, 0.74, 0.42, 0.80),
            (-2.10, 0.86, 0.84, 0.28, 0.95),
            (-1.30, 0.90, 0.86, 0.22, 0.97),
            (0.95, 0.90, 0.86, 0.22, 0.95),
            (1.90, 0.86, 0.80, 0.24, 0.78),
            (2.20, 0.72, 0.68, 0.36, 0.66),
        ],
        cabin=[
            (-1.75, 0.80, 0.74, 0.92, 0.95),
            (-1.05, 0.82, 0.60, 0.92, 1.42),
            (0.15, 0.82, 0.60, 0.92, 1.43),
            (1.05, 0.80, 0.72, 0.90, 0.95),
        ],
        wheels=_four(1.35, 1.35, 0.78),
        radius_m=0.32,
    )
    hatchback = _vehicle(
        "hatchback",
        car,
        body=[
            (-1.95, 0.74, 0.74, 0.40, 0.95),
            (-1.80, 0.84, 0.80, 0.26, 1.00),
            (0.85, 0.86, 0.82, 0.22, 0.98),
            (1.70, 0.82, 0.76, 0.24, 0.82),
            (1.95, 0.68, 0.64, 0.36, 0.68),
        ],
        cabin=[
            (-1.88, 0.78, 0.70, 0.98, 1.02),
            (-1.55, 0.80, 0.60, 0.98, 1.46),
            (0.10, 0.80, 0.60, 0.96, 1.50),
            (1.00, 0.76, 0.70, 0.94, 0.98),
        ],
        wheels=_four(1.22, 1.22, 0.74),
        radius_m=0.30,
    )
    suv = _vehicle(
        "suv",
        car,
        body=[
            (-2.30, 0.82, 0.82, 0.48, 1.05),
            (-2.20, 0.92, 0.90, 0.34, 1.12),
            (1.05, 0.95, 0.92, 0.28, 1.12),
            (2.10, 0.92, 0.86, 0.32, 1.00),
            (2.32, 0.78, 0.76, 0.44, 0.88),
        ],
        cabin=[
            (-2.25, 0.84, 0.74, 1.10, 1.14),
            (-1.95, 0.86, 0.68, 1.10, 1.70),
            (0.25, 0.86, 0.68, 1.10, 1.72),
            (1.15, 0.84, 0.76, 1.08, 1.12),
        ],
        wheels=_four(1.45, 1.45, 0.80),
        radius_m=0.36,
    )
    estate = _vehicle(
        "estate",
        car,
        body=[
            (-2.35, 0.76, 0.74, 0.42, 0.95),
            (-2.20, 0.88, 0.84, 0.26, 1.00),
            (1.00, 0.90, 0.86, 0.22, 0.96),
            (2.00, 0.86, 0.80, 0.24, 0.80),
            (2.30, 0.72, 0.68, 0.36, 0.68),
        ],
        cabin=[
            (-2.28, 0.80, 0.70, 0.96, 1.00),
            (-1.85, 0.82, 0.62, 0.96, 1.44),
            (0.20, 0.82, 0.62, 0.94, 1.47),
            (1.10, 0.78, 0.72, 0.92, 0.96),
        ],
        wheels=_four(1.40, 1.40, 0.78),
        radius_m=0.33,
    )
    return (saloon, hatchback, suv, estate)


def vans() -> tuple[Model, ...]:
    """Return models of vans."""
    van = StreetClass.VAN

    def made(name: str, half_m: float, high_m: float) -> Model:
        return _vehicle(
            name,
            van,
            body=[
                (-half_m, 0.95, 0.88, 0.40, high_m - 0.02),
                (half_m - 1.55, 0.98, 0.86, 0.30, high_m),
                (half_m - 1.50, 0.98, 0.94, 0.30, 1.12),
                (half_m - 0.50, 0.96, 0.90, 0.32, 1.02),
                (half_m, 0.80, 0.78, 0.42, 0.85),
            ],
            cabin=[
                (half_m - 1.58, 0.92, 0.84, 1.10, high_m - 0.08),
                (half_m - 1.40, 0.92, 0.82, 1.10, high_m - 0.10),
                (half_m - 0.55, 0.90, 0.84, 1.02, 1.08),
            ],
            wheels=_four(half_m - 0.95, half_m - 1.05, 0.85),
            radius_m=0.35,
        )

    return (made("van", 2.55, 2.00), made("tall van", 2.95, 2.65))


def trucks() -> tuple[Model, ...]:
    """Return models of trucks, with and without a trailer."""
    truck = StreetClass.TRUCK

    def cab(front_m: float) -> list[Mesh]:
        return [
            loft(
                [
                    (front_m - 1.9, 1.15, 1.10, 0.60, 2.85),
                    (front_m - 0.2, 1.20, 1.15, 0.45, 2.85),
                    (front_m, 1.18, 1.10, 0.45, 1.55),
                ],
                what=truck,
                sides=Material.COLOURED,
                top=Material.COLOURED,
            ),
            box(
                *(0.04, 2.0, 1.65, 2.5),
                what=truck,
                material=Material.GLASS,
                x_m=front_m - 0.06,
            ),
            *_plates(
                truck,
                (front_m, 1.1, 1.1, 0.5, 0.9),
                (-front_m, 1.1, 1.1, 0.5, 0.9),
            ),
        ]

    def hold(rear_m: float, front_m: float, low_m: float, high_m: float) -> Mesh:
        sections = [(rear_m, 1.25, 1.25, low_m, high_m), (front_m, 1.25, 1.25, low_m, high_m)]
        return loft(sections, what=truck, sides=Material.COLOURED, top=Material.COLOURED)

    def chassis(rear_m: float, front_m: float) -> Mesh:
        return box(
            *(front_m - rear_m, 0.9, 0.55, 1.0),
            what=truck,
            material=Material.METAL,
            x_m=(front_m + rear_m) / 2,
        )

    wheels = wheels_at(truck, [*_four(2.7, 2.3, 1.05), (-2.3, 0.0)], 0.48, 0.3)
    lorry = [*cab(4.0), hold(-4.0, 1.95, 1.0, 3.5), chassis(-3.9, 3.8), *wheels]
    axles = [(-5.0, 1.05), (-5.0, -1.05), (-6.3, 1.05), (-6.3, -1.05), (3.8, 1.05), (3.8, -1.05)]
    long = [
        *cab(8.0),
        hold(-8.0, 5.7, 1.2, 3.9),
        chassis(-7.8, 7.8),
        *wheels_at(truck, [(6.7, 1.05), (6.7, -1.05), *axles], 0.5, 0.35),
    ]
    road_train = [
        *cab(9.4),
        hold(-0.9, 7.2, 1.1, 3.9),
        hold(-9.4, -2.2, 1.1, 3.9),
        chassis(-9.2, 9.2),
        *wheels_at(truck, [*_four(8.1, 8.3, 1.05), *_four(1.0, 3.6, 1.05)], 0.5, 0.35),
    ]
    tipper = [
        *cab(3.6),
        loft(
            [(-3.6, 1.0, 1.2, 1.1, 2.4), (1.5, 1.0, 1.2, 1.1, 2.3)],
            what=truck,
            sides=Material.COLOURED,
            top=Material.STONE,
        ),
        chassis(-3.5, 3.4),
        *wheels_at(truck, [*_four(2.4, 1.4, 1.05), (-2.6, 1.05), (-2.6, -1.05)], 0.5, 0.3),
    ]
    return (
        make_model("lorry", truck, [lorry]),
        make_model("long lorry", truck, [long]),
        make_model("road train", truck, [road_train]),
        make_model("tipper", truck, [tipper]),
    )


def buses() -> tuple[Model, ...]:
    """Return models of buses: long, short and articulated."""
    bus = StreetClass.BUS

    def made(name: str, half_m: float) -> Model:
        parts = [
            loft(
                [(-half_m, 1.25, 1.25, 0.35, 1.25), (half_m, 1.25, 1.25, 0.35, 1.25)],
                what=bus,
                sides=Material.COLOURED,
                top=Material.COLOURED,
            ),
            loft(
                [
                    (-half_m + 0.03, 1.22, 1.20, 1.25, 2.5),
                    (half_m - 0.03, 1.22, 1.20, 1.25, 2.5),
                ],
                what=bus,
                sides=Material.GLASS,
                top=Material.GLASS,
            ),
            loft(
                [(-half_m, 1.25, 1.15, 2.5, 3.05), (half_m, 1.25, 1.15, 2.5, 3.05)],
                what=bus,
                sides=Material.COLOURED,
                top=Material.COLOURED,
            ),
            *[
                box(*(0.12, 2.48, 1.2, 2.55), what=bus, material=Material.COLOURED, x_m=float(x))
                for x in np.arange(-half_m + 0.8, half_m - 0.5, 1.5)
            ],
            *wheels_at(bus, _four(half_m - 2.6, half_m - 3.2, 1.1), 0.48, 0.3),
            *_plates(bus, (half_m, 1.2, 1.2, 0.5, 1.0), (-half_m, 1.2, 1.2, 0.5, 1.0)),
        ]
        return make_model(name, bus, [parts])

    return (made("bus", 6.0), made("short bus", 4.2), made("articulated bus", 9.3))
