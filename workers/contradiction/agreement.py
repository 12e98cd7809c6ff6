"""Agreement of the two streams, per point."""

from schemas.arrays import Agreements, Labels
from schemas.overlay import agreements_of
from schemas.task import MOTION, Task


def compare(semantic: Labels, predictive: Labels, task: Task = MOTION) -> Agreements:
    """Compare the labels of the two streams, per point.

    For motion the outcomes are the four of the paper (arXiv 2407.14306, section III-C). This method
    adds `not_compared`: a point without a label of one stream must not count as static.

    Args:
        semantic: (N,) uint8 labels of the supervised stream.
        predictive: (N,) uint8 labels of the self-supervised stream.
        task: The task of both streams.

    Returns:
        (N,) uint8 codes of the task's outcomes; `not_compared` where either label is `unknown`.

    Raises:
        ValueError: If the two streams labelled a different number of points.
    """
    if semantic.shape != predictive.shape:
        raise ValueError(
            f"streams labelled different points: {len(semantic)} semantic, "
            f"{len(predictive)} predictive; a stage must never drop or reorder points"
        )
    return agreements_of(semantic, predictive, task)
