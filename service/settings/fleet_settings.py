"""Settings of large fleets: order, what is mined again, and workers on a Ray cluster."""

from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field

from service.curation.priorities import MAX_PRIORITIES, Priorities
from service.settings.lock_settings import listed

MAX_BYTES: Final = 10**18

MAX_CORE_HOURS: Final = 1e6
"""Most hours of a core in a day: those of 40,000 cores."""


def _priorities(written: tuple[str, ...]) -> tuple[str, ...]:
    Priorities.parse(written)
    return written


PriorityNames = Annotated[
    tuple[str, ...],
    BeforeValidator(listed),
    AfterValidator(_priorities),
    Field(max_length=MAX_PRIORITIES),
]


class FleetSettings(BaseModel):
    """Settings of large fleets, a part of all settings."""

    remine: Literal["newest", "selected", "none"] = Field(
        default="newest",
        description="Logs that are mined again where a new pipeline version changes labels or "
        "contradictions; their scenes stay until then. newest: all; selected: those with selected "
        "or judged scenes; none: no log. Always in this order: new logs, canary, selected or "
        "judged, the newest.",
    )
    remine_core_hours_a_day: float = Field(
        default=0.0,
        ge=0,
        le=MAX_CORE_HOURS,
        description="Hours of one core that mining logs again may take within a day; 0: no limit. "
        "New logs are mined in any case.",
    )
    remine_canary_share: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of the logs mined again that is finished before the others begin.",
    )
    standby: bool = Field(
        default=False,
        description="`service` waits while another service holds its `database`, and takes over "
        "when that one dies, freezes or loses the database. Set it for both; needs `database` "
        "and `artifacts`.",
    )
    standby_after_s: float = Field(
        default=5.0,
        ge=3,
        le=600,
        description="Silence of the active service after which a standby takes over, and after "
        "which the active one withdraws.",
    )
    priorities: PriorityNames = Field(
        default=(),
        description="Vehicles or folders in the order in which their logs are mined, as patterns "
        "for the vehicle, the folder or the log id; `others` are the rest, which is last "
        "otherwise. "
        "`car-9=4`: at most 4 leases at a time; `test/*=25%`: at most this share of the leases "
        "while other work waits.",
    )
    bucket_notices: bool = Field(
        default=False,
        description="Take notices of changed objects at `/bucket-notices` of `http_listen`, in the "
        "form of S3 events; only the objects that they name are looked up.",
    )
    notified_list_interval_s: float = Field(
        default=3600.0,
        gt=0,
        le=1e9,
        description="Interval of listings in place of `list_interval_s` with `bucket_notices`: "
        "they find what no notice has named.",
    )
    artifacts_budget_bytes: int = Field(
        default=0,
        ge=0,
        le=MAX_BYTES,
        description="Bytes of overlays at most, looked at each half hour; 0: no limit. First those "
        "of withdrawn scenes are deleted, then those of the lowest scores; never those of selected "
        "or judged scenes.",
    )
    pool: Literal["local", "ray"] = Field(
        default="local",
        description="Keeper of the workers of `worker`: local: processes of this machine; ray: "
        "actors of a Ray cluster (extra `ray`).",
    )
    ray_address: str = Field(
        default="auto", description="Address of the Ray cluster; auto: the one of this machine."
    )
    ray_most_workers: int = Field(
        default=0,
        ge=0,
        le=100_000,
        description="Workers of the pool `ray` at most; between `workers` and this their number "
        "follows the work that waits; 0: always `workers`.",
    )
    ray_cpus: float = Field(
        default=1.0, gt=0, le=1024, description="Cores that Ray reserves for one worker."
    )
    ray_gpus: float = Field(
        default=0.0,
        ge=0,
        le=64,
        description="GPUs that Ray reserves for one worker, such as 0.25: four share one.",
    )
