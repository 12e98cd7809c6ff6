"""Interface of an output that is no folder of this machine, such as a bucket."""

from pathlib import Path
from typing import Protocol


class Sink(Protocol):
    """Output of an export that grows in a working folder.

    Every method raises a `CounterpointError` if the output does not answer or refuses.
    """

    @property
    def url(self) -> str:
        """Address of the output, as the user wrote it, without credentials."""

    def is_empty(self) -> bool:
        """Return True if nothing lies there."""

    def has(self, place: str) -> bool:
        """Return True if a file, or a folder with files, lies at this place."""

    def send(self, path: Path, place: str) -> None:
        """Store a file or a whole folder at a place, instead of what was there."""

    def read_journal(self, name: str) -> bytes | None:
        """Read the journal; None where there is none."""

    def write_journal(self, name: str, data: bytes) -> None:
        """Replace the journal.

        Raises:
            StateInUseError: If another export has written it since it was read.
        """
