"""Models of pedestrians, riders and animals, with swinging legs."""

from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, ball, box, limb, loft
from workers.lab.simulation.models.model import PHASES, Model, make_model, wheels_at


def _person(
    what: StreetClass,
    *,
    swing: float,
    tall: float = 1.0,
    x_m: float = 0.0,
    low_m: float = 0.0,
    load: bool = False,
) -> list[Mesh]:
    """Build a pedestrian; `swing` in -1 to 1 is the lead of the left leg."""
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


def pedestrians() -> tuple[Model, ...]:
    """Return models of pedestrians, alone or with a load."""
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
                parts += wheels_at(person, [(0.5, 0.2), (0.5, -0.2), (1.0, 0.0)], 0.13, 0.04)
            phases.append(parts)
        return make_model(name, person, phases, stride_m=1.45 * tall)

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
        *wheels_at(what, [(half, 0.0), (-half, 0.0)], radius_m, thick_m),
        limb((-half, 0.0, radius_m), (0.0, 0.0, 0.32), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((-0.15, 0.0, 0.85), (0.0, 0.0, 0.32), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((half, 0.0, radius_m), (half - 0.2, 0.0, 1.0), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((half - 0.2, -0.28, 1.0), (half - 0.2, 0.28, 1.0), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
        limb((-0.15, 0.0, 0.8), (half - 0.22, 0.0, 0.85), 0.03, 0.03, sides=5, **bar),  # type: ignore[arg-type]
    ]


def _rider(what: StreetClass, *, low_m: float, turn: float, lean_m: float) -> list[Mesh]:
    """Build a rider; `turn` is the angle of the pedals, radians."""
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


def cyclists() -> tuple[Model, ...]:
    """Return models of cyclists."""
    cyclist = StreetClass.CYCLIST
    bicycle = _two_wheels(cyclist, wheelbase_m=1.05, radius_m=0.34, thick_m=0.05)
    turns = 2 * np.pi * np.arange(PHASES) / PHASES
    return tuple(
        make_model(
            name,
            cyclist,
            [[*bicycle, *_rider(cyclist, low_m=0.0, turn=float(t), lean_m=lean)] for t in turns],
            stride_m=4.5,
        )
        for name, lean in (("cyclist", 0.15), ("racing cyclist", 0.38))
    )


def motorcycles() -> tuple[Model, ...]:
    """Return models of motorcycles and scooters with riders."""
    motorcycle = StreetClass.MOTORCYCLE
    frame = _two_wheels(motorcycle, wheelbase_m=1.45, radius_m=0.32, thick_m=0.16)
    body = loft(
        [(-0.75, 0.12, 0.14, 0.55, 0.85), (0.0, 0.2, 0.2, 0.3, 0.9), (0.45, 0.16, 0.18, 0.4, 0.95)],
        what=motorcycle,
        sides=Material.COLOURED,
        top=Material.COLOURED,
    )
    rider = _rider(motorcycle, low_m=-0.05, turn=0.3, lean_m=0.2)
    return (make_model("motorcycle", motorcycle, [[*frame, body, *rider]]),)


def animals() -> tuple[Model, ...]:
    """Return models of animals that cross streets."""
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
        return make_model(name, animal, phases, stride_m=0.9 * scale)

    return (made("dog", 0.95, 0.05), made("deer", 1.7, 0.35), made("small dog", 0.6, 0.0))
