"""Standing ghosts: what the supervised stream alone labels dynamic, although it stands.

The box of a ghost on a wall or a hedge slides along it: each frame labels another stretch of the
same structure. Its path then shows no motion. The points themselves do not move, and two sources
that know nothing of boxes see that: the shape lies on the same structure earlier and later, and
free space finds its places occupied. A person who walks along a beam appears static to free space
too, but not by shape. A bus that sets off lies over its own shape, but free space sees its ends
move.
"""

from schemas.task import Outcome, Task


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
    if kind.of_witness or kind.measured or kind.semantic != task.moving:
        return 0.0
    return shape_static * witness_static
