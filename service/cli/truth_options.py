"""Options of the verbs that compare with truth."""

from pathlib import Path
from typing import Annotated

import typer

from service.errors import UsageError

Truth = Annotated[
    Path,
    typer.Option(
        "--truth",
        help="Folder DIR with the truth of BUCKET/x/y.mcap in DIR/x/y; see deploy/TRUTH.md.",
    ),
]
Frames = Annotated[
    str, typer.Option("--frames", help="Frames A:B of each log, half open; earlier ones warm up.")
]


def parse_frames(text: str) -> tuple[int, int | None]:
    """Parse the half-open range `A:B`; either side may be empty.

    Raises:
        UsageError: If it is not two counts with a colon between them.
    """
    first, colon, last = text.partition(":")
    try:
        if not colon:
            raise ValueError
        bounds = (int(first or 0), int(last) if last else None)
    except ValueError:
        raise UsageError(f"--frames must be A:B, such as 10:56, got {text!r}") from None
    if bounds[0] < 0 or (bounds[1] is not None and bounds[1] <= bounds[0]):
        raise UsageError(f"--frames {text!r} holds no frame")
    return bounds
