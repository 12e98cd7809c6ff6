"""Errors of weights."""

from schemas.errors import PermanentError


class WeightsUnusableError(PermanentError):
    """Weights are missing, damaged, or belong to another network than stated."""


class UnfitWeightsError(WeightsUnusableError):
    """Parameters do not fit the network.

    Attributes:
        missing: Names that only the network has, in its order.
        unexpected: Names that only the weights have, in their order.
    """

    def __init__(
        self, message: str, *, missing: tuple[str, ...] = (), unexpected: tuple[str, ...] = ()
    ) -> None:
        """Store every name; the message has room for a few."""
        super().__init__(message)
        self.missing, self.unexpected = missing, unexpected
