"""Data sets that can be converted: names, licences, attributions, layouts and their readers."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from workers.lab.datasets.conversion.source import DatasetUnusableError, SourceLog
from workers.lab.datasets.published import (
    argoverse2,
    kitti360,
    kitti_raw,
    nuscenes,
    once,
    pandaset,
    semantickitti,
)
from workers.lab.datasets.published.options import ReadOptions


@dataclass(frozen=True, slots=True)
class Layout:
    """A published data set.

    Attributes:
        name: As the command takes it.
        title: Its own name.
        licence: Licence, by its short name.
        attribution: Whom to name.
        expected: Files by which the layout is recognised, for people.
        pattern: Pattern of one of these files below the root.
        find_logs: Reads its logs.
    """

    name: str
    title: str
    licence: str
    attribution: str
    expected: str
    pattern: str
    find_logs: Callable[[Path, ReadOptions], list[SourceLog]]

    @property
    def terms(self) -> str:
        """Licence and attribution in one line."""
        return f"{self.title}: {self.licence}; attribution: {self.attribution}"


_KITTI: Final = "Geiger, Lenz, Stiller, Urtasun (KIT, TTI-C)"

LAYOUTS: Final = (
    Layout(
        name="semantickitti",
        title="SemanticKITTI, KITTI odometry",
        licence="CC BY-NC-SA 3.0, labels CC BY-NC-SA 4.0, no commercial use",
        attribution=f"{_KITTI}; labels: Behley et al. (University of Bonn)",
        expected="sequences/NN/velodyne/NNNNNN.bin",
        pattern="**/[0-9][0-9]/velodyne",
        find_logs=semantickitti.find_logs,
    ),
    Layout(
        name="kitti-raw",
        title="KITTI raw",
        licence="CC BY-NC-SA 3.0, no commercial use",
        attribution=_KITTI,
        expected="DATE/DATE_drive_NNNN_sync/velodyne_points/data/NNNNNNNNNN.bin",
        pattern="**/*_drive_*/velodyne_points/data",
        find_logs=kitti_raw.find_logs,
    ),
    Layout(
        name="kitti360",
        title="KITTI-360",
        licence="CC BY-NC-SA 3.0, no commercial use",
        attribution="Liao, Xie, Geiger (University of Tuebingen)",
        expected="data_3d_raw/DRIVE/velodyne_points/data/NNNNNNNNNN.bin",
        pattern="data_3d_raw/*/velodyne_points",
        find_logs=kitti360.find_logs,
    ),
    Layout(
        name="pandaset",
        title="PandaSet",
        licence="CC BY 4.0",
        attribution="PandaSet by Hesai and Scale AI",
        expected="NNN/lidar/NN.pkl.gz and NNN/lidar/poses.json",
        pattern="**/lidar/poses.json",
        find_logs=pandaset.find_logs,
    ),
    Layout(
        name="argoverse2",
        title="Argoverse 2 Sensor Dataset",
        licence="CC BY-NC-SA 4.0, no commercial use",
        attribution="Wilson et al. (Argo AI)",
        expected="LOG/sensors/lidar/STAMP.feather and LOG/city_SE3_egovehicle.feather",
        pattern="**/sensors/lidar",
        find_logs=argoverse2.find_logs,
    ),
    Layout(
        name="nuscenes",
        title="nuScenes",
        licence="CC BY-NC-SA 4.0, no commercial use",
        attribution="Caesar et al. (Motional)",
        expected="v1.0-VERSION/scene.json, samples and sweeps",
        pattern="**/sample_data.json",
        find_logs=nuscenes.find_logs,
    ),
    Layout(
        name="once",
        title="ONCE",
        licence="CC BY-NC-SA 4.0, no commercial use",
        attribution="Mao et al. (Huawei)",
        expected="data/NNNNNN/lidar_roof/STAMP.bin and data/NNNNNN/NNNNNN.json",
        pattern="**/lidar_roof",
        find_logs=once.find_logs,
    ),
)

LAYOUT_NAMES: Final = tuple(layout.name for layout in LAYOUTS)


def find_layout(name: str) -> Layout:
    """Find a data set by its name.

    Raises:
        DatasetUnusableError: If there is none.
    """
    for layout in LAYOUTS:
        if layout.name == name:
            return layout
    raise DatasetUnusableError(f"no data set {name!r}; known: {', '.join(LAYOUT_NAMES)}")


def open_logs(layout: Layout, source: Path, options: ReadOptions) -> list[SourceLog]:
    """Find the logs of a data set in a folder.

    Raises:
        DatasetUnusableError: If there is none, or a file is missing or damaged. The message names
            the data set that the folder looks like.
    """
    if not source.is_dir():
        raise DatasetUnusableError(f"no such folder: {source}")
    if not any(source.iterdir()):
        raise DatasetUnusableError(
            f"the folder is empty: {source}; {layout.title} has {layout.expected}"
        )
    logs = layout.find_logs(source, options)
    if logs:
        return logs
    like = next((each for each in LAYOUTS if next(source.glob(each.pattern), None)), None)
    guess = f": this looks like {like.title}, `convert {like.name}`" if like is not None else ""
    raise DatasetUnusableError(
        f"no log of {layout.title} in {source}{guess}; expected {layout.expected}"
    )
