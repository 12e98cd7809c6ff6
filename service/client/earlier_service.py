"""Refusals of a service of an earlier version, in words for a person."""

from collections.abc import Sequence

from schemas.errors import PermanentError


def refusal_to_learn(error: PermanentError, connect: Sequence[str]) -> PermanentError:
    """Return the refusal of a learned ranking; that of an unknown field names the version."""
    if "learned: Extra inputs" not in str(error):
        return error
    return PermanentError(
        f"the service at {','.join(connect)} is of an earlier version, which does not learn from "
        "verdicts: update it, or rank without --learned"
    )
