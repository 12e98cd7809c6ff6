"""Open a scene with the nuScenes devkit; return the second keyframe's points and their names."""

import json
import sys

import numpy as np
from nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud

read = NuScenes("v1.0-counterpoint", sys.argv[1], verbose=False)
token = read.sample[1]["data"]["LIDAR_TOP"]
cloud = LidarPointCloud.from_file(read.get_sample_data_path(token))
labels = np.fromfile(f"{sys.argv[1]}/{read.get('lidarseg', token)['filename']}", dtype=np.uint8)
json.dump(
    {
        "points": cloud.points[:3].T.tolist(),
        "names": [read.lidarseg_idx2name_mapping[number] for number in labels.tolist()],
        "samples": read.get("scene", read.scene[0]["token"])["nbr_samples"],
        "log": read.log[0]["logfile"],
    },
    sys.stdout,
)
