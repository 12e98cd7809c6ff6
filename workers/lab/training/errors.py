"""Errors of a training run, each a sentence that names what to do."""

import errno
from typing import Final

from schemas.errors import PermanentError

NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS)
"""A full disk or quota, a limit of the size of files, or a folder that is not writable."""


class TrainingDataError(PermanentError):
    """The data of a run are missing, too few, or do not fit the network."""


class TrainingDivergedError(PermanentError):
    """The loss is not a number; the last good weights were kept."""


class ResumeRefusedError(PermanentError):
    """An unfinished run in the folder was started with other data or settings."""


class StateUnwritableError(PermanentError):
    """The state of a run cannot be written; started again, it goes on from the last one."""
