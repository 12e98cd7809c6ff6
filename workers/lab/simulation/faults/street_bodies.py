"""True boxes of the objects of a simulated street, as its detector sees them."""

import numpy as np

from workers.lab.simulation.faults.detected_boxes import Body
from workers.lab.simulation.world.street import Street


def street_bodies(street: Street, time_s: float) -> dict[int, Body]:
    """Return the true box of every actor of a street at a time, by its number; world space."""
    velocities = street.actor_velocities(time_s)
    found = {}
    for track, (actor, pose) in enumerate(
        zip(street.actors, street.actor_bodies(time_s), strict=True)
    ):
        x, y, z, yaw, _, _ = pose
        size = np.array(actor.size_m)
        found[track] = Body(
            actor.street_class.name.lower(),
            np.array([x, y, z + size[2] / 2]),
            float(yaw),
            size,
            velocities[track],
        )
    return found
