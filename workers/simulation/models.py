"""What each kind of actor is made of: bodies with windows and wheels, people whose legs swing."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np

from workers.simulation.kinds import Material, StreetClass
from workers.simulation.meshes import Mesh, ball, box, limb, loft

PHASES: Final = 8
"""Poses of one stride of whoever walks or pedals."""

Section = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The shape of an actor in its own space: x ahead, z up, the origin on the ground below it.

    Attributes:
        name: Unique.
        street_class: What it is.
        size_m: Length, width, height of the box around it, centred on the origin.
        phases: Its shape through one stride; a single one where nothing swings.
        stride_m: Way of one stride.
    """

    name: str
    street_class: StreetClass
    size_m: tuple[float, float, float]
    phases: tuple[Mesh, ...]
    stride_m: float = 1.0


@cache
def models_of(street_class: StreetClass) -> tuple[Model, ...]:
    """Give the models of a class; the first is the plainest.

    Raises:
        KeyError: If nothing of that class ever moves.
    """
    return _MAKERS[street_class]()


def _model(
    name: str,
    what: StreetClass,
    phases: list[list[Mesh]],
    stride_m: float = 1.0,
    *,
    beyond_size: Sequence[Mesh] = (),
) -> Model:
    """Put a model together; what is `beyond_size` sticks out of its box."""
    meshes = tuple(Mesh.merged(parts) for parts in phases)
    corners = np.concatenate([mesh.corners_m for mesh in meshes])
    half = np.abs(corners[:, :2]).max(axis=0)
    size = (2 * float(half[0]), 2 * float(half[1]), float(corners[:, 2].max()))
    whole = tuple(Mesh.merged([mesh, *beyond_size]) for mesh in meshes)
    return Model(name, what, size, whole, stride_m)


def _wheels(
    what: StreetClass, places: list[tuple[float, float]], radius_m: float, width_m: float
) -> list[Mesh]:
    return [
        limb(
            (x, y - width_m / 2, radius_m),
            (x, y + width_m / 2, radius_m),
            radius_m,
            radius_m,
            what=what,
            material=Material.RUBBER,
            sides=12,
        )
        for x, y in places
    ]


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
        *_wheels(what, wheels, radius_m, 0.24),
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
    return _model(name, what, [parts], beyond_size=mirrors)


def _plates(what: StreetClass, nose: Section, tail: Section) -> list[Mesh]:
    """Number plates and lamps: what shines brightest of a car."""
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


def _cars() -> tuple[Model, ...]:
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


def _vans() -> tuple[Model, ...]:
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


def _trucks() -> tuple[Model, ...]:
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

    wheels = _wheels(truck, [*_four(2.7, 2.3, 1.05), (-2.3, 0.0)], 0.48, 0.3)
    lorry = [*cab(4.0), hold(-4.0, 1.95, 1.0, 3.5), chassis(-3.9, 3.8), *wheels]
    axles = [(-5.0, 1.05), (-5.0, -1.05), (-6.3, 1.05), (-6.3, -1.05), (3.8, 1.05), (3.8, -1.05)]
    long = [
        *cab(8.0),
        hold(-8.0, 5.7, 1.2, 3.9),
        chassis(-7.8, 7.8),
        *_wheels(truck, [(6.7, 1.05), (6.7, -1.05), *axles], 0.5, 0.35),
    ]
    road_train = [
        *cab(9.4),
        hold(-0.9, 7.2, 1.1, 3.9),
        hold(-9.4, -2.2, 1.1, 3.9),
        chassis(-9.2, 9.2),
        *_wheels(truck, [*_four(8.1, 8.3, 1.05), *_four(1.0, 3.6, 1.05)], 0.5, 0.35),
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
        *_wheels(truck, [*_four(2.4, 1.4, 1.05), (-2.6, 1.05), (-2.6, -1.05)], 0.5, 0.3),
    ]
    return (
        _model("lorry", truck, [lorry]),
        _model("long lorry", truck, [long]),
        _model("road train", truck, [road_train]),
        _model("tipper", truck, [tipper]),
    )


def _buses() -> tuple[Model, ...]:
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
            *_wheels(bus, _four(half_m - 2.6, half_m - 3.2, 1.1), 0.48, 0.3),
            *_plates(bus, (half_m, 1.2, 1.2, 0.5, 1.0), (-half_m, 1.2, 1.2, 0.5, 1.0)),
        ]
        return _model(name, bus, [parts])

    return (made("bus", 6.0), made("short bus", 4.2), made("articulated bus", 9.3))


def _person(
    what: StreetClass,
    *,
    swing: float,
    tall: float = 1.0,
    x_m: float = 0.0,
    low_m: float = 0.0,
    load: bool = False,
) -> list[Mesh]:
    """Make a walker; `swing` in -1 to 1 is how far the left leg is ahead."""
    hip, shoulder, head = 0.88 * tall, 1.45 * tall, 1.62 * tall
    wear: Final = Material.COLOURED
    parts = [
        loft(
            [
                (x_m - 0.12, 0.16, 0.21, hip - 0.05, shoulder),
                (x_m + 0.12, 0.16, 0.20, hip, shoulder),
            ],
            what=what,
            sides=wear,
            top=wear,
        ),
        ball((x_m, 0.0, head), (0.1, 0.09, 0.13), what=what, material=Material.SKIN),
    ]
    for side in (1.0, -1.0):
        ahead = swing * side
        foot = (x_m + 0.36 * ahead * tall, 0.09 * side, 0.05 + 0.08 * max(0.0, -ahead))
        knee = (x_m + 0.18 * ahead * tall + 0.06, 0.09 * side, hip / 2)
        hand = (x_m - 0.28 * ahead * tall, 0.26 * side, 0.85 * tall)
        parts += [
            limb((x_m, 0.09 * side, hip), knee, 0.09, 0.065, what=what, material=wear, sides=6),
            limb(knee, foot, 0.065, 0.05, what=what, material=wear, sides=6),
            box(
                *(0.26, 0.09, foot[2] - 0.04, foot[2] + 0.04),
                what=what,
                material=Material.RUBBER,
                x_m=foot[0] + 0.06,
                y_m=foot[1],
            ),
            limb(
                (x_m, 0.21 * side, shoulder - 0.05),
                hand,
                0.05,
                0.04,
                what=what,
                material=wear,
                sides=6,
            ),
        ]
    if load:
        parts.append(box(0.18, 0.3, 1.0 * tall, shoulder, what=what, material=wear, x_m=x_m - 0.22))
    return [part.placed(0.0, 0.0, low_m) for part in parts] if low_m else parts


def _pedestrians() -> tuple[Model, ...]:
    person = StreetClass.PEDESTRIAN
    swings = np.sin(2 * np.pi * np.arange(PHASES) / PHASES)

    def made(name: str, tall: float, *, load: bool = False, pram: bool = False) -> Model:
        phases = []
        for swing in swings:
            parts = _person(person, swing=float(swing), tall=tall, load=load)
            if pram:
                parts.append(
                    box(0.7, 0.45, 0.35, 0.95, what=person, material=Material.COLOURED, x_m=0.75)
                )
                parts += _wheels(person, [(0.5, 0.2), (0.5, -0.2), (1.0, 0.0)], 0.13, 0.04)
            phases.append(parts)
        return _model(name, person, phases, stride_m=1.45 * tall)

    return (
        made("adult", 1.0),
        made("tall adult", 1.08, load=True),
        made("child", 0.68),
        made("adult with pram", 0.97, pram=True),
    )


def _two_wheels(
    what: StreetClass, *, wheelbase_m: float, radius_m: float, thick_m: float
) -> list[Mesh]:
    half = wheelbase_m / 2
    bar = {"what": what, "material": Material.METAL}
    return [
        *_wheels(what, [(half, 0.0), (-half, 0.0)], radius_m, thick_m),
        limb((-half, 0.0, radius_m), (0.0, 0.0, 0.32), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((-0.15, 0.0, 0.85), (0.0, 0.0, 0.32), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((half, 0.0, radius_m), (half - 0.2, 0.0, 1.0), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((half - 0.2, -0.28, 1.0), (half - 0.2, 0.28, 1.0), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((-0.15, 0.0, 0.8), (half - 0.22, 0.0, 0.85), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
    ]


def _rider(what: StreetClass, *, low_m: float, turn: float, lean_m: float) -> list[Mesh]:
    """Make a rider; `turn` is the angle of the pedals."""
    hip, shoulder = (-0.2, 0.0, low_m + 0.9), (-0.2 + lean_m, 0.0, low_m + 1.42)
    wear = Material.COLOURED
    parts = [
        limb(hip, shoulder, 0.17, 0.2, what=what, material=wear, sides=8),
        ball(
            (shoulder[0] + 0.08, 0.0, shoulder[2] + 0.22),
            (0.12, 0.1, 0.14),
            what=what,
            material=Material.SKIN,
        ),
    ]
    for side in (1.0, -1.0):
        phase = turn + (0.0 if side > 0 else np.pi)
        foot = (0.05 + 0.17 * np.cos(phase), 0.12 * side, low_m + 0.3 + 0.17 * np.sin(phase))
        knee = (0.22 + 0.06 * np.cos(phase), 0.14 * side, low_m + 0.72 + 0.08 * np.sin(phase))
        hand = (0.35, 0.25 * side, low_m + 1.02)
        parts += [
            limb(
                (hip[0], 0.1 * side, hip[2]), knee, 0.085, 0.065, what=what, material=wear, sides=6
            ),
            limb(knee, foot, 0.06, 0.05, what=what, material=wear, sides=6),
            limb(
                (shoulder[0], 0.2 * side, shoulder[2] - 0.05),
                hand,
                *(0.05, 0.04),
                what=what,
                material=wear,
                sides=6,
            ),
        ]
    return parts


def _cyclists() -> tuple[Model, ...]:
    cyclist = StreetClass.CYCLIST
    bicycle = _two_wheels(cyclist, wheelbase_m=1.05, radius_m=0.34, thick_m=0.05)
    turns = 2 * np.pi * np.arange(PHASES) / PHASES
    return tuple(
        _model(
            name,
            cyclist,
            [[*bicycle, *_rider(cyclist, low_m=0.0, turn=float(t), lean_m=lean)] for t in turns],
            stride_m=4.5,
        )
        for name, lean in (("cyclist", 0.15), ("racing cyclist", 0.38))
    )


def _motorcycles() -> tuple[Model, ...]:
    motorcycle = StreetClass.MOTORCYCLE
    frame = _two_wheels(motorcycle, wheelbase_m=1.45, radius_m=0.32, thick_m=0.16)
    body = loft(
        [(-0.75, 0.12, 0.14, 0.55, 0.85), (0.0, 0.2, 0.2, 0.3, 0.9), (0.45, 0.16, 0.18, 0.4, 0.95)],
        what=motorcycle,
        sides=Material.COLOURED,
        top=Material.COLOURED,
    )
    rider = _rider(motorcycle, low_m=-0.05, turn=0.3, lean_m=0.2)
    return (_model("motorcycle", motorcycle, [[*frame, body, *rider]]),)


def _animals() -> tuple[Model, ...]:
    animal = StreetClass.ANIMAL

    def made(name: str, scale: float, neck: float) -> Model:
        phases = []
        for swing in np.sin(2 * np.pi * np.arange(PHASES) / PHASES):
            parts = [
                ball((0.0, 0.0, 0.55), (0.42, 0.15, 0.17), what=animal, material=Material.COLOURED),
                limb(
                    *((0.33, 0.0, 0.6), (0.5, 0.0, 0.72 + neck), 0.08, 0.07),
                    what=animal,
                    material=Material.COLOURED,
                    sides=6,
                ),
                ball(
                    (0.58, 0.0, 0.76 + neck),
                    (0.14, 0.07, 0.08),
                    what=animal,
                    material=Material.COLOURED,
                ),
            ]
            for x, y, way in ((0.3, 0.09, 1), (0.3, -0.09, -1), (-0.3, 0.09, -1), (-0.3, -0.09, 1)):
                parts.append(
                    limb(
                        *((x, y, 0.5), (x + 0.18 * way * swing, y, 0.02), 0.05, 0.03),
                        what=animal,
                        material=Material.COLOURED,
                        sides=6,
                    )
                )
            phases.append([part.placed(0.0, 0.0, scale=scale) for part in parts])
        return _model(name, animal, phases, stride_m=0.9 * scale)

    return (made("dog", 0.95, 0.05), made("deer", 1.7, 0.35), made("small dog", 0.6, 0.0))


_MAKERS: Final = {
    StreetClass.CAR: _cars,
    StreetClass.VAN: _vans,
    StreetClass.TRUCK: _trucks,
    StreetClass.BUS: _buses,
    StreetClass.PEDESTRIAN: _pedestrians,
    StreetClass.CYCLIST: _cyclists,
    StreetClass.MOTORCYCLE: _motorcycles,
    StreetClass.ANIMAL: _animals,
}
