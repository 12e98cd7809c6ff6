"""What can be wrong with weights."""

from schemas.errors import PermanentError


class WeightsUnusableError(PermanentError):
    """Weights are missing, damaged, or belong to another network than is said."""


class UnfitWeightsError(WeightsUnusableError):
    """Parameters do not fit the network.

    Attributes:
        missing: Names that the network has and the weights have not, in the network's order.
        unexpected: Names that only the weights have, in theirs.
    """

    def __init__(
        self, message: str, *, missing: tuple[str, ...] = (), unexpected: tuple[str, ...] = ()
    ) -> None:
        """Keep every name; the message has room for a few."""
        super().__init__(message)
        self.missing, self.unexpected = missing, unexpected
