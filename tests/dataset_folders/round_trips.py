"""Round trips of the real excerpts: folder of the data set, converted back, compared.

`python -m tests.dataset_folders.round_trips ../shared [NAME …]` prints a line of JSON for each.
"""

import csv
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.dataset_folders.argoverse2 import write_argoverse2
from tests.dataset_folders.kitti import write_kitti360, write_kitti_raw, write_semantickitti
from tests.dataset_folders.pandaset import write_pandaset
from tests.dataset_folders.real_logs import RealLog, clouds_in, intensity_of, xyz_of
from workers.lab.datasets.conversion.convert import convert
from workers.lab.datasets.published.catalogue import find_layout, open_logs
from workers.lab.datasets.published.options import ReadOptions

KEYS = {
    "pandaset": "pandaset/panda-01/2019-05-11/pandaset-002",
    "semantickitti": "kitti/annieway-kitti/2011-10-03/kitti-odometry-00",
    "kitti-raw": "kitti/annieway-kitti/2011-09-26/kitti-raw-standing-1430",
    "kitti360": "kitti360/annieway-360/2013-05-28/kitti360-3000_0",
    "argoverse2": "av2/av2-pit/1980-01-06/av2-7fab2350-pair",
}


def round_trip(name: str, reference: Path, work: Path, *, frames: int = 1000) -> dict[str, Any]:
    """Write an excerpt as a folder of its data set, convert it, and compare with the log."""
    log = RealLog(reference, KEYS[name])
    source = work / "source"
    if name == "pandaset":
        count = min(frames, 56)
        write_pandaset(source, log, count)
    elif name == "semantickitti":
        count = min(frames, 16)
        write_semantickitti(source, log, count)
    elif name == "argoverse2":
        count = 2
        write_argoverse2(source, log)
    else:
        clouds = list(log.clouds())[:frames]
        count = len(clouds)
        write = write_kitti_raw if name == "kitti-raw" else write_kitti360
        write(source, clouds, log.icp_poses())
    layout = find_layout(name)
    logs = open_logs(layout, source, ReadOptions())
    written = list(convert(layout, logs, to=str(work / "logs"), truth=work / "truth"))
    converted = work / "logs" / f"{written[0].log}.mcap"
    truth = work / "truth" / written[0].log
    return {
        "dataset": name,
        "log": written[0].log,
        "frames": written[0].frames,
        "expected_frames": count,
        **_points(log, converted, count),
        **_poses(log, truth, count),
        **_codes(log, truth, count),
    }


def _points(log: RealLog, converted: Path, count: int) -> dict[str, Any]:
    points = differing = rings = 0
    stamp_ns = offset_ns = 0
    largest_m = 0.0
    for before, after, _ in zip(log.clouds(), clouds_in(converted), range(count), strict=False):
        assert len(before) == len(after), (len(before), len(after))
        a, b = xyz_of(before).astype(np.float32), xyz_of(after).astype(np.float32)
        same = (a == b).all(axis=1) & (intensity_of(before) == intensity_of(after))
        points, differing = points + len(a), differing + int(np.count_nonzero(~same))
        largest_m = max(largest_m, float(np.abs(a - b).max()))
        stamp_ns = max(stamp_ns, abs(before.stamp_ns - after.stamp_ns))
        if "ring" in before.fields:
            rings += int(np.count_nonzero(before.fields["ring"] != after.fields["ring"]))
        for field in ("t", "offset_ns"):
            if field in before.fields:
                apart = before.fields[field].astype(np.int64) - after.fields[field].astype(np.int64)
                offset_ns = max(offset_ns, int(np.abs(apart).max()))
    return {
        "points": points,
        "points_differing": differing,
        "largest_point_error_m": largest_m,
        "rings_differing": rings,
        "largest_stamp_error_ns": stamp_ns,
        "largest_offset_error_ns": offset_ns,
    }


def _poses(log: RealLog, truth: Path, count: int) -> dict[str, Any]:
    file = log.truth / "poses.npz"
    if file.is_file():
        with np.load(file) as arrays:
            expected = arrays["world_from_lidar_at_stamp"][:count]
    else:
        expected = log.icp_poses()[:count]
    with np.load(truth / "poses.npz") as arrays:
        found = arrays["world_from_lidar_at_stamp"]
    # a world of its own: compared from the first pose on
    first, other = np.linalg.inv(expected[0]), np.linalg.inv(found[0])
    error = [
        np.linalg.norm((first @ a)[:3, 3] - (other @ b)[:3, 3])
        for a, b in zip(expected, found, strict=True)
    ]
    return {"largest_pose_error_m": float(max(error))}


def _codes(log: RealLog, truth: Path, count: int) -> dict[str, Any]:
    """Count differing truth codes, over the arrays that both have."""
    compared: dict[str, int] = {}
    differing: dict[str, int] = {}
    last_known = 0
    names = _renamed_tracks(log, truth)
    for number in range(count):
        if not (log.truth / f"{number:06d}.npz").is_file():
            continue
        before = log.labels(number)
        with np.load(truth / f"{number:06d}.npz") as arrays:
            after = dict(arrays)
        for name, mine in _aligned(before, after, names).items():
            a, b = mine
            compared[name] = compared.get(name, 0) + len(a)
            differing[name] = differing.get(name, 0) + int(np.count_nonzero(a != b))
        last_known += 1
    return {"codes_compared": compared, "codes_differing": differing}


def _renamed_tracks(log: RealLog, truth: Path) -> dict[int, int] | None:
    """Return the number in the pack of each converted track."""
    if not (log.truth / "tracks.csv").is_file():
        return None
    of_uuid = {row["uuid"]: int(row["track_id"]) for row in log.tracks()}
    with (truth / "tracks.csv").open(newline="") as file:
        found = {int(row["track_id"]): of_uuid[row["uuid"]] for row in csv.DictReader(file)}
    return {**found, -1: -1}


def _aligned(
    before: dict[str, NDArray[Any]],
    after: dict[str, NDArray[Any]],
    tracks: dict[int, int] | None,
) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
    pairs = {"motion": (before["motion"], after["motion"])}
    if tracks is not None:
        table = np.array([tracks[n] for n in sorted(tracks)], np.int16)
        pairs["track"] = (before["track"], table[after["track"].astype(np.intp) + 1])
    for mine, theirs in (("semantic", "semantic"), ("semantic", "semantic_box")):
        if mine in after and theirs in before:
            pairs[mine] = (before[theirs], after[mine])
    if "semantic19" in before:
        # labels state motion: a movable point of unknown motion was written without its class
        kept = before["motion"] != 0
        pairs["semantic19"] = (before["semantic19"][kept], after["semantic19"][kept])
    if "ground" in before and "ground" in after:
        kept = before["motion"] != 0
        pairs["ground"] = (before["ground"][kept], after["ground"][kept])
    return pairs


def main(arguments: list[str]) -> None:
    """Run the named round trips, or all."""
    reference = Path(arguments[0])
    for name in arguments[1:] or KEYS:
        with TemporaryDirectory(prefix="round-trip-") as work:
            sys.stdout.write(json.dumps(round_trip(name, reference, Path(work))) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
