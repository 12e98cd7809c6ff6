"""What can go wrong in the service; `schemas.errors` says what transient and permanent mean."""

from schemas.errors import PermanentError, TransientError


class UsageError(PermanentError):
    """Arguments that cannot be meant; the message says which and what would do."""


class StateUnusableError(PermanentError):
    """The state folder cannot be written, or belongs to a newer version."""


class StateOutdatedError(StateUnusableError):
    """An older version wrote the state; a service that starts on it brings it up to date."""


class OtherBucketError(PermanentError):
    """The state belongs to another bucket."""


class StatementFailedError(PermanentError):
    """The database refuses what it was asked, and would again: only that question fails."""


class RecordDamagedError(PermanentError):
    """A stored record is not what its digest says; it is not shown."""


class StateInUseError(TransientError):
    """Another service holds this state folder."""


class NothingFoundError(PermanentError):
    """What was asked for does not exist: a scene, a selection, any lidar."""
