"""Every setting of the command, with its default; flags win over `COUNTERPOINT_*` variables."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from schemas.keys import DEFAULT_ROOT
from schemas.work import Grid, MiningSettings
from service.errors import UsageError

DEFAULT_STATE = Path("counterpoint-state")
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


class Settings(BaseSettings):
    """What one command runs with. Credentials of buckets are not here: obstore reads its own."""

    model_config = SettingsConfigDict(
        env_prefix="COUNTERPOINT_", env_nested_delimiter="__", extra="forbid", frozen=True
    )

    bucket: str = Field(default="", description="URL of the log bucket.")
    artifacts: str = Field(
        default="", description="URL for overlays; empty: the folder `artifacts` in the state."
    )
    state: Path = Field(default=DEFAULT_STATE, description="Folder of the ledger and overlays.")
    root: str = Field(default=DEFAULT_ROOT, pattern=r"^[A-Za-z0-9_-]+$", description="Key root.")
    connect: str = Field(default="", description="Endpoint of a router, `tcp/host:port`.")
    listen: str = Field(default="", description="Endpoint a router listens on; empty: a free one.")
    workers: int = Field(default=2, ge=1, le=256, description="Worker processes of `run`.")
    grid: Grid = Field(default_factory=Grid, description="Scene and shard lengths, warm-up.")
    odometry: str = Field(default="kiss-icp", description="Odometry, by name.")
    supervised: str = Field(default="salsanext-lmnet", description="Supervised stream, by name.")
    selfsupervised: str = Field(default="registration", description="Self-supervised stream.")
    lidar_topic: str = Field(default="", description="Mine this topic only; empty: by evidence.")
    path_template: str = Field(
        default="{vehicle}/{date}/{name}", description="Identity, matched from the key's right."
    )
    stamp_at: Literal["start", "middle", "end"] = Field(
        default="start", description="Instant of the revolution that a header stamp names."
    )
    intensity_scale: float = Field(
        default=0.0, ge=0, description="Recorded intensity that means 1; 0: by evidence."
    )
    list_interval_s: float = Field(
        default=10.0, gt=0, description="Between listings of the bucket."
    )
    lease_s: float = Field(default=30.0, gt=1, description="A lease lives this long unrenewed.")
    max_attempts: int = Field(default=5, ge=1, description="Then a shard is parked.")
    shard_deadline_s: float = Field(
        default=1800.0, gt=0, description="A worker longer than this on one lease is killed."
    )

    def mining(self) -> MiningSettings:
        """Return what every worker must do alike."""
        return MiningSettings(
            bucket=self.bucket,
            artifacts=self.artifacts or (self.state.resolve() / "artifacts").as_uri(),
            grid=self.grid,
            supervised=self.supervised,
            selfsupervised=self.selfsupervised,
            odometry=self.odometry,
            lidar_topic=self.lidar_topic,
            path_template=self.path_template,
            stamp_at=self.stamp_at,
            intensity_scale=self.intensity_scale,
        )


def load_settings(**flags: Any) -> Settings:
    """Read the settings: flags that were given (not None) over the environment over defaults.

    Raises:
        UsageError: If a value is impossible; the message names it.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    try:
        return Settings(**given)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'settings'}: {e['msg']}" for e in error.errors()
        )
        raise UsageError(f"impossible settings: {problems}") from None
