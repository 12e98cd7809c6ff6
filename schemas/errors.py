"""Base classes of errors; the class says whether a retry may help.

The command line exits with code 75 on a `TransientError` and with 1 on a `PermanentError`.
"""


class CounterpointError(Exception):
    """Base of every error raised on purpose."""


class TransientError(CounterpointError):
    """A failure that may pass: the lease is returned and tried again later."""


class PermanentError(CounterpointError):
    """A failure that a retry cannot cure: it is recorded and reported, and the rest goes on."""


class BucketUnreachableError(TransientError):
    """The store does not answer, or answers with an error of its own."""


class BucketRefusedError(PermanentError):
    """The store refuses: no such bucket or folder, missing or wrong credentials, wrong URL."""


class ObjectChangedError(TransientError):
    """An object has changed since it was planned; its log must be planned again."""

    def __init__(self, *, key: str) -> None:
        """Keep the key, by which the ledger plans the recording again."""
        super().__init__(f"object was replaced or deleted while it was read ({key})")
        self.key = key
