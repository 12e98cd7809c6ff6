"""What can go wrong, and whether trying again may help: a class, not a guess.

The command line answers a `TransientError` with exit code 75 and a `PermanentError` with 1.
"""


class CounterpointError(Exception):
    """Base of every error raised on purpose."""


class TransientError(CounterpointError):
    """May work next time: the lease goes back and is tried again later."""


class PermanentError(CounterpointError):
    """Will never work as it stands: it is recorded, said, and the rest goes on."""


class BucketUnreachableError(TransientError):
    """The store does not answer, or answers with an error of its own."""


class BucketRefusedError(PermanentError):
    """The store says no: no such bucket or folder, missing or wrong credentials, wrong URL."""


class ObjectChangedError(TransientError):
    """An object is no longer the one that was planned: its log must be planned anew."""

    def __init__(self, *, key: str) -> None:
        """Keep the key: the ledger plans its recording again."""
        super().__init__(f"object was replaced or deleted while it was read ({key})")
        self.key = key
