"""Backlog of a service: work that waits and work that is leased; pools take their size from it."""

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Count


class WorkBacklog(BaseModel):
    """Plans and shards of the newest pipeline version; the reply to `backlog`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    waiting: Count = Field(description="Plans and shards that wait for a worker.")
    leased: Count = Field(description="Plans and shards that a worker has now.")
