"""Parquet of all labelled points: each with the index of its raw point."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from schemas.errors import PermanentError
from workers.lab.lidarcoda.annotations import Coda
from workers.lab.lidarcoda.files import read_box
from workers.lab.lidarcoda.grades import object_labels, read_grades

TABLE: Final = "labels.parquet"


def need_pyarrow() -> None:
    """Refuse where pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        raise PermanentError(
            "a Parquet of labels needs pyarrow: install 'counterpoint[predictions]'"
        )


def write_table(out: Path, coda: Coda) -> int:
    """Write `labels.parquet`: a row for each point of each graded annotation.

    Columns: image, file_name, dataset, annotation, category, supercategory, point (its row in the
    cloud), x, y, z (metres, lidar space of the data set), object (true or false), grade.

    Returns:
        Number of rows.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    grades = read_grades(out)
    fields = [
        *(("image", pa.int32()), ("file_name", pa.string()), ("dataset", pa.string())),
        *(("annotation", pa.int32()), ("category", pa.string()), ("supercategory", pa.string())),
        *(("point", pa.int32()), ("x", pa.float32()), ("y", pa.float32()), ("z", pa.float32())),
        *(("object", pa.bool_()), ("grade", pa.int8())),
    ]
    schema = pa.schema(fields, metadata={b"counterpoint.form": b"lidarcoda"})
    rows = 0
    temporary = out / f"{TABLE}.tmp"
    with pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        for annotation in coda.annotations:
            if annotation.id not in grades:
                continue
            image = coda.images[annotation.image_id]
            box, grade = read_box(out, annotation.id), grades[annotation.id]
            count = len(box.index)
            texts = (annotation.category, annotation.supercategory)
            values: dict[str, Any] = {
                "image": np.full(count, image.id, np.int32),
                "file_name": [image.file_name] * count,
                "dataset": [str(image.dataset)] * count,
                "annotation": np.full(count, annotation.id, np.int32),
                "category": [texts[0]] * count,
                "supercategory": [texts[1]] * count,
                "point": box.index,
                **{name: box.columns[:, place] for place, name in enumerate("xyz")},
                "object": object_labels(box, grade) > 0,
                "grade": np.full(count, grade, np.int8),
            }
            writer.write_table(pa.table(values, schema=schema))
            rows += count
    temporary.replace(out / TABLE)
    return rows
