"""Interface of a format: what it writes for each scene, and at the end for all of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.curation.selection import Selection
from service.export.scene import SceneToExport

WriteScene = Callable[[SceneToExport, Path], None]
"""Writes one scene to a file or folder that does not exist yet; its parent exists."""

WriteAll = Callable[[Selection, Sequence[SceneToExport], Path], None]
"""Writes what is about all exported scenes into an empty folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One format of `counterpoint export`.

    Attributes:
        name: As `--format` names it.
        text: What it is for, in a line of the help.
        ending: Ending of a scene's file; empty: a scene is a folder.
        folder: Folder of the scenes, relative to the output; empty: the output itself.
        numbered: True if a scene's name is its number alone, as the format prescribes.
        write_scene: Writes a scene; None for a format with nothing for each scene.
        write_all: Writes the files about all scenes; None without any.
        reads_logs: True if the points of the log are written, so that a bucket is needed.
        check: Raises UsageError if a package is missing; None for a format that needs none.
    """

    name: str
    text: str
    ending: str = ""
    folder: str = ""
    numbered: bool = False
    write_scene: WriteScene | None = None
    write_all: WriteAll | None = None
    reads_logs: bool = False
    check: Callable[[], None] | None = None

    def place_of(self, scene: SceneToExport) -> str:
        """Return the path of a scene's file or folder, relative to the output."""
        name = f"{scene.number:02d}" if self.numbered else scene.stem
        return f"{self.folder}/{name}{self.ending}" if self.folder else f"{name}{self.ending}"
