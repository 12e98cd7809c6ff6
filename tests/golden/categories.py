"""The four categories of the paper, by their published numbers."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Agreements
from schemas.labels import Agreement

CATEGORIES: Final = {
    Agreement.BOTH_STATIC: 1,
    Agreement.BOTH_DYNAMIC: 2,
    Agreement.ONLY_PREDICTIVE_DYNAMIC: 3,
    Agreement.ONLY_SEMANTIC_DYNAMIC: 4,
    Agreement.NOT_COMPARED: 0,
}
"""Published number of each agreement; 0 for points not compared, which no published file has."""

_TABLE: Final = np.array([CATEGORIES[each] for each in sorted(Agreement)], dtype=np.int16)


def categories(agreements: Agreements) -> NDArray[np.int16]:
    """Return the paper's number of each point (section III-C and its code).

    Args:
        agreements: (N,) values of `Agreement`.

    Returns:
        (N,) int16: 1 both static, 2 both dynamic, 3 only the self-supervised stream dynamic, 4
        only the supervised one, 0 not compared.
    """
    return _TABLE[agreements]
