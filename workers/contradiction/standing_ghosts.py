"""Standing ghosts: what the supervised stream alone labels dynamic, although it stands.

The box of a ghost on a wall or a hedge slides along it: each frame labels another stretch of the
same structure. Its path then shows no motion. The points themselves do not move, and two sources
that know nothing of boxes see that: the shape lies on the same structure earlier and later, and
free space finds its places occupied. A person who walks along a beam appears static to free space
too, but not by shape. A bus that sets off lies over its own shape, but free space sees its ends
move. Labels that bleed from a mover onto the structure behind it slide too, and are no ghost
(`bled_labels.py`).

The shape of a ghost on a rail or a hedge can also be found elsewhere, since such a structure
repeats itself. An object can only have arrived at a place that was free before, and free space is
queried for that (`path_share`).
"""

from typing import Final

from schemas.task import Outcome, Task
from workers.contradiction.clamp import clamp01
from workers.contradiction.flashes import has_no_motion_source

_OCCUPIED: Final = 0.75
"""Share of static points by the witness above which no place was free: the rest is its noise."""


def standing_share(
    kind: Outcome, task: Task, *, shape_static: float, witness_static: float
) -> float:
    """Return the evidence that a track that only the supervised stream labels dynamic stands.

    Args:
        kind: Kind of the track.
        task: Its task.
        shape_static: Agreement of its shape with points in the same place, earlier and later.
        witness_static: Share of its points that the witness labels static.

    Returns:
        0 to 1; 0 for kinds whose box follows a motion source.
    """
    return shape_static * witness_static if has_no_motion_source(kind, task) else 0.0


def path_share(kind: Outcome, task: Task, *, witness_static: float) -> float:
    """Return the share of an arrival or a departure by shape that free space leaves possible.

    Args:
        kind: Kind of the track.
        task: Its task.
        witness_static: Share of its points that the witness labels static.

    Returns:
        0 where the witness found all of its places occupied, 1 up to three quarters of them; 1 for
        kinds whose box follows a motion source.
    """
    if not has_no_motion_source(kind, task):
        return 1.0
    return clamp01((1.0 - witness_static) / (1.0 - _OCCUPIED))
