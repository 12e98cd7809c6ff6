"""Every format of a selection: one row each. A new one is a file in this folder and a row."""

from collections.abc import Mapping
from typing import Final

from service.errors import UsageError
from service.export.fiftyone_dataset import FIFTYONE
from service.export.format import Format
from service.export.json_lines import JSON
from service.export.labelstudio import LABELSTUDIO
from service.export.mcap_excerpt import MCAP
from service.export.nuscenes_lidarseg import NUSCENES
from service.export.openlabel import OPENLABEL
from service.export.parquet import PARQUET
from service.export.pcd import CVAT, XTREME1
from service.export.rerun_recording import RERUN
from service.export.segments import SEGMENTS
from service.export.semantickitti import SEMANTICKITTI

_ROWS: Final = (
    *(MCAP, SEMANTICKITTI, OPENLABEL, SEGMENTS, CVAT, XTREME1, LABELSTUDIO),
    *(NUSCENES, FIFTYONE, RERUN, PARQUET, JSON),
)

FORMATS: Final[Mapping[str, Format]] = {each.name: each for each in _ROWS}
"""By the name that `counterpoint export --format` takes."""


def format_named(name: str) -> Format:
    """Find a format.

    Raises:
        UsageError: If there is none of that name.
    """
    found = FORMATS.get(name)
    if found is None:
        raise UsageError(f"no format {name!r}: --format is one of {', '.join(FORMATS)}")
    return found
