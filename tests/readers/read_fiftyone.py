"""Import an export as a FiftyOne dataset into its database; return what the samples have."""

import json
import sys

import fiftyone

dataset = fiftyone.Dataset.from_dir(
    dataset_dir=sys.argv[1], dataset_type=fiftyone.types.FiftyOneDataset, persistent=False
)
found = [
    {
        "frame": sample["frame"],
        "media": sample.media_type,
        "labels": [each.label for each in sample["contradictions"].detections],
    }
    for sample in dataset
]
json.dump({"selection": dataset.info["selection"], "samples": found}, sys.stdout)
