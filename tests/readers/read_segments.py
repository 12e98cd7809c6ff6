"""Read a scene with the types of Segments.ai's SDK: the sample, and the labels of its points."""

import json
import sys
from pathlib import Path

from segments.typing import (
    PointcloudSequenceSampleAttributes,
    PointcloudSequenceSegmentationLabelAttributes,
)

folder = Path(sys.argv[1])
attributes = json.loads((folder / "sample.json").read_text())["attributes"]
sample = PointcloudSequenceSampleAttributes.model_validate(attributes)
label = PointcloudSequenceSegmentationLabelAttributes.model_validate_json(
    (folder / "label.json").read_text()
)
category = {each.id: each.category_id for each in label.frames[0].annotations}
json.dump(
    {
        "types": [frame.pcd.type for frame in sample.frames],
        "ahead_m": [frame.ego_pose.position.x for frame in sample.frames],
        "categories": [category[number] for number in label.frames[0].point_annotations],
    },
    sys.stdout,
)
