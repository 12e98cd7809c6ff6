"""Every form of finished labels: one row each. A new one is a file in this folder and a row."""

from collections.abc import Mapping
from typing import Final

from service.errors import UsageError
from service.export.labels.cvat import CVAT_LABELS
from service.export.labels.fiftyone import FIFTYONE_LABELS
from service.export.labels.form import LabelForm
from service.export.labels.labelstudio import NAME as LABEL_STUDIO
from service.export.labels.nuscenes import NUSCENES_LABELS
from service.export.labels.openlabel import OPENLABEL_LABELS
from service.export.labels.pcd import PCD_LABELS
from service.export.labels.segments import SEGMENTS_LABELS
from service.export.labels.semantickitti import SEMANTICKITTI_LABELS
from service.export.labels.xtreme1 import XTREME1_LABELS

_ROWS: Final = (
    *(SEMANTICKITTI_LABELS, SEGMENTS_LABELS, NUSCENES_LABELS, PCD_LABELS),
    *(OPENLABEL_LABELS, CVAT_LABELS, XTREME1_LABELS, FIFTYONE_LABELS),
)

LABEL_FORMS: Final[Mapping[str, LabelForm]] = {each.name: each for each in _ROWS}
"""Forms of labels of points, by the name that `import-labels --format` takes."""

ALL_NAMES: Final = (*LABEL_FORMS, LABEL_STUDIO)
"""Values of `--format`; answers of Label Studio label no points."""


def form_named(name: str) -> LabelForm:
    """Find a form.

    Raises:
        UsageError: If labels of that form are not read.
    """
    found = LABEL_FORMS.get(name)
    if found is None:
        known = ", ".join(ALL_NAMES)
        raise UsageError(f"no labels of format {name!r} are read: --format is one of {known}")
    return found
