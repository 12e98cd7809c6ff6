"""Errors of the service; `schemas.errors` defines transient and permanent errors."""

from schemas.errors import PermanentError, TransientError


class UsageError(PermanentError):
    """Invalid arguments; the message names them and lists valid ones."""


class StateUnusableError(PermanentError):
    """The state folder cannot be written, or belongs to a newer version."""


class DatabaseTakenError(StateUnusableError):
    """Another service serves the database now; this one may neither read nor write it."""


class StateOutdatedError(StateUnusableError):
    """State of an older version; a service that starts on it migrates it."""


class OtherBucketError(PermanentError):
    """The state belongs to another bucket."""


class StatementFailedError(PermanentError):
    """The database refuses a statement, and always would; only that request fails."""


class RecordDamagedError(PermanentError):
    """A stored record does not match its digest; it is not shown."""


class StateInUseError(TransientError):
    """Another service holds this state folder."""


class NothingFoundError(PermanentError):
    """The requested object does not exist, such as a scene, a selection, or any lidar."""
