"""Model of all settings, with defaults that a file, variables and flags override.

Flags override `COUNTERPOINT_*` variables, which override the file that `--config` or
COUNTERPOINT_CONFIG names. `deploy/SETTINGS.md` has the same table.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from schemas.bounds import Url
from schemas.camera import RECORDED, CameraCalibration
from schemas.mining import MiningSettings
from schemas.motion_rule import MotionRule
from schemas.runtime.named_file import read_named_file
from schemas.runtime.real_path import real_path
from schemas.transport.keys import DEFAULT_ROOT
from service.curation.event_types import EVENTS
from service.errors import UsageError
from service.settings.fleet_settings import FleetSettings
from service.settings.lock_settings import LockSettings, Names, listed
from service.settings.messages import allowed, impossible
from service.settings.presets import PRESETS, Preset
from service.settings.secrets import exposed_secrets
from service.settings.sources import CONFIG_VARIABLE, Written, lay, leaves, nested
from service.settings.webhook_fields import WebhookEvents, WebhookUrls

DEFAULT_STATE = Path("counterpoint-state")
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

MAX_WAIT_S: Final = 1e9
"""Longest interval, seconds, 31 years; the limit of a lock's timeout is nine times as long."""

MAX_DAYS: Final = 1e6

NOT_IN_VERSION: Final = frozenset({"bucket", "artifacts", "model", "weights", "device", "pictures"})
"""Settings shared by workers that no pipeline version depends on."""


def _postgres(url: str) -> str:
    """Accept any of PostgreSQL's URL schemes, and no other database."""
    scheme, separator, rest = url.partition("://")
    if url and (not separator or scheme not in _POSTGRES):
        raise ValueError("empty or a URL like postgresql://user@host:5432/name")
    parts = urlsplit(url)
    if parts.netloc.count("@") > 1 or "password" in parts.query:
        raise ValueError("a URL with its password before the @ only, percent-encoded")
    return f"{_POSTGRES[-1]}://{rest}" if url else url


_POSTGRES: Final = ("postgres", "postgresql", "postgresql+psycopg")

OwnCauses = Annotated[
    tuple[Annotated[str, Field(min_length=1, max_length=64)], ...], BeforeValidator(listed)
]
PostgresUrl = Annotated[str, AfterValidator(_postgres)]


def part_names() -> Mapping[str, list[str]]:
    """Return what each setting that names a part may be, by the catalogue of parts."""
    from workers.parts.catalogue import names_of
    from workers.parts.part import KINDS

    return {kind: names_of(kind) for kind in KINDS if kind != "network"}


def allowed_values() -> dict[str, str]:
    """Describe what the value of every setting may be, by its dotted name."""
    parts = {setting: f"one of {', '.join(names)}" for setting, names in part_names().items()}
    return allowed(Settings) | parts


class Settings(LockSettings, FleetSettings, MiningSettings):
    """Settings of one command. Bucket credentials are not among them: obstore reads its own.

    The settings that workers share are inherited, and part of the pipeline version but for
    `NOT_IN_VERSION`. A change of one of those means that everything is mined again.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    preset: Preset = Field(
        default="default",
        description="Named group of settings; any setting written elsewhere overrides it. "
        "`paper`: the published chain, which needs `weights` and a camera's "
        "calibration.",
    )
    bucket: Url = Field(default="", description="URL or path of the log bucket; only read.")
    artifacts: Url = Field(
        default="", description="URL for overlays; empty: the folder `artifacts` in the state."
    )
    state: Path = Field(
        default=DEFAULT_STATE, description="Folder of lock, ledger and overlays, on a local disk."
    )
    root: str = Field(
        default=DEFAULT_ROOT,
        pattern=r"^[A-Za-z0-9_-]+$",
        description="First part of every Zenoh key; two systems on one router need two.",
    )
    workers: int = Field(
        default=2, ge=1, le=256, description="Worker processes of `run` and `worker`."
    )
    include: Names = Field(
        default=(),
        description="Only keys that match one of these patterns (`*` also crosses `/`).",
    )
    exclude: Names = Field(default=(), description="Excluded keys, as patterns.")
    list_interval_s: float = Field(
        default=10.0, gt=0, le=MAX_WAIT_S, description="Interval of listings of the bucket."
    )
    settle_s: float = Field(
        default=30.0,
        ge=0,
        le=MAX_WAIT_S,
        description="Time for which an object without a valid footer must be unchanged before it "
        "is planned; above 0 a daemon lets a log wait for predictions next to it.",
    )
    keep_withdrawn_days: float = Field(
        default=0.0,
        ge=0,
        le=MAX_DAYS,
        description="Days after which the overlays of withdrawn scenes are deleted from the "
        "artifacts; 0: never.",
    )
    keep_pipelines: Names = Field(
        default=(),
        description="Pipeline versions, or their first characters, whose overlays are never "
        "deleted: versions that are being compared. Their scores are always kept.",
    )
    causes: OwnCauses = Field(
        default=(),
        max_length=100,
        description="Causes of errors that reviewers may name, in addition to the taxonomy.",
    )
    database: PostgresUrl = Field(
        default="",
        repr=False,  # may hold a password
        description="URL of a PostgreSQL, `postgresql://user@host/name`; empty: a SQLite file in "
        "the state folder.",
    )
    http_listen: str = Field(
        default="127.0.0.1:9464",
        description="Address at which `run` and `service` serve /metrics, /healthz, /readyz and "
        "/rates; empty: none. Not with --once.",
    )
    worker_http_listen: str = Field(
        default="127.0.0.1:9465",
        description="Address at which `worker` serves /metrics, /healthz and /readyz; empty: none.",
    )
    review_listen: str = Field(
        default="127.0.0.1:8087",
        description="Address at which `review` and `run --review` serve the review page; port 0 "
        "takes a free one.",
    )
    review_hosts: Names = Field(
        default=(),
        description="Names under which browsers may ask for the review page, in addition to those "
        "of the loopback and to its own address.",
    )
    webhooks: WebhookUrls = Field(
        default=(),
        repr=False,  # may hold a token
        description="URLs that `run` and `service` send signed events to, `http` or `https`. Needs "
        "`webhook_secret_file`.",
    )
    webhook_secret_file: str = Field(
        default="",
        description="File with the secret that signs webhooks: 24 to 64 bytes in base64, as "
        "`openssl rand -base64 32` prints them.",
    )
    webhook_events: WebhookEvents = Field(
        default=EVENTS,
        description=f"Events that webhooks are sent: {', '.join(EVENTS)}.",
    )
    webhook_min_score: float = Field(
        default=0.5, ge=0, le=1, description="Least score of a scene of the event `scene.new`."
    )
    review_exports: str = Field(
        default="",
        description="Folder or bucket URL of the exports that are started on the review page; "
        "empty: `exports` in the state folder, none with `connect`.",
    )
    vehicles: Names = Field(
        default=(),
        max_length=50,
        description="Vehicles that have a series of their own in the metrics; others are `other`.",
    )
    heartbeat_s: float = Field(
        default=300.0,
        gt=0,
        le=MAX_WAIT_S,
        description="Interval of an idle daemon's log lines.",
    )
    log_format: Literal["console", "json"] = Field(
        default="console", description="Format of the log: plain text, or JSON lines."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Least level that is logged."
    )
    lease_s: float = Field(
        default=30.0, gt=1, le=MAX_WAIT_S, description="Duration of a lease without renewal."
    )
    max_attempts: int = Field(
        default=5,
        ge=1,
        le=1_000_000,
        description="Failed attempts after which a shard is parked; also after twice as many "
        "worker deaths on it, of any cause.",
    )
    shard_deadline_s: float = Field(
        default=1800.0,
        gt=0,
        le=MAX_WAIT_S,
        description="Longest time of a worker on one lease; then it is killed.",
    )

    @field_validator("odometry", "supervised", "selfsupervised", "witness", "instances")
    @classmethod
    def _is_a_part(cls, name: str, setting: ValidationInfo) -> str:
        if name not in (known := part_names()[setting.field_name or ""]):
            raise ValueError(f"one of {', '.join(known)}")
        return name

    @property
    def artifacts_url(self) -> str:
        """URL of the bucket for overlays."""
        return self.artifacts or (real_path(self.state) / "artifacts").as_uri()

    def mining(self) -> MiningSettings:
        """Return the settings that every worker shares.

        Raises:
            UsageError: If a path is too long for a message once it is absolute.
        """
        shared = {name: getattr(self, name) for name in MiningSettings.model_fields}
        model, weights = (
            str(real_path(Path(path))) if path else "" for path in (self.model, self.weights)
        )
        files = {"artifacts": self.artifacts_url, "model": model, "weights": weights}
        if self.predictions and "://" not in self.predictions:
            files["predictions"] = str(real_path(Path(self.predictions)))
        try:
            return MiningSettings(**shared | files | _contents(self))
        except ValidationError as error:
            first = error.errors()[0]
            raise UsageError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error


def _contents(settings: "Settings") -> dict[str, str]:
    """Read the files whose content, not their path, goes to the workers."""
    return {"camera": _camera(settings.camera), "motion_rule": _motion_rule(settings.motion_rule)}


def _motion_rule(said: str) -> str:
    if not said:
        return said
    try:
        return MotionRule.model_validate_json(read_named_file(Path(said))).model_dump_json()
    except OSError as error:
        raise UsageError(
            f"motion_rule: a JSON file of thresholds: {error.strerror} ({said})"
        ) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise UsageError(f"motion_rule: {where}: {first['msg']} ({said})") from error


def _camera(said: str) -> str:
    """Read a calibration file; its content, not its path, goes to the workers."""
    if said in ("", RECORDED):
        return said
    try:
        stated = CameraCalibration.model_validate_json(read_named_file(Path(said)))
    except OSError as error:
        raise UsageError(
            f"camera: `{RECORDED}` or a JSON file of a calibration: {error.strerror} ({said})"
        ) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise UsageError(f"camera: {where}: {first['msg']} ({said})") from error
    return stated.model_dump_json(exclude_none=True)


def cache_folder() -> Path:
    """Return the folder of caches on this machine, next to the compiled loops.

    It is `NUMBA_CACHE_DIR`, else the user's cache folder, and never one that is cleaned while a
    daemon runs, such as `/tmp`.

    Raises:
        UsageError: If there is neither.
    """
    if kept := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(kept)
    if cache := os.environ.get("XDG_CACHE_HOME"):
        return Path(cache) / "counterpoint"
    try:
        return Path.home() / ".cache" / "counterpoint"
    except RuntimeError:
        raise UsageError("no home folder to keep files in: set NUMBA_CACHE_DIR") from None


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """Settings, and the source of each value.

    Attributes:
        settings: The settings in effect.
        written: By dotted name, the deciding value of each setting that is not at its default.
        file: The file that was read, if any.
    """

    settings: Settings
    written: Mapping[str, Written]
    file: Path | None


def _preset(laid: Mapping[str, Written]) -> dict[str, Written]:
    """Return the settings of the chosen preset; an unknown one is refused with the other errors."""
    written = laid.get("preset")
    said = PRESETS.get(str(written.value), {}) if written is not None else {}
    return {
        name: Written("preset", f"preset {written.value}", name, value)
        for name, value in said.items()
        if written is not None
    }


def load_settings(*, config: Path | None = None, **flags: Any) -> Settings:
    """Read the settings; `read_settings` also returns the source of each value."""
    return read_settings(config=config, **flags).settings


def read_settings(*, config: Path | None = None, **flags: Any) -> ReadSettings:
    """Read the settings: flags that were given (not None) over variables over the file.

    Args:
        config: A TOML file; None: the one that COUNTERPOINT_CONFIG names, if any.
        flags: By the name of the setting, or of the flag with underscores for dashes.

    Raises:
        UsageError: If a name is unknown or a value impossible; the message names them all in their
            original spelling, and shows no password.
    """
    named = os.environ.get(CONFIG_VARIABLE, "")
    file = config or (Path(named) if named else None)
    known = leaves(Settings)
    laid, problems = lay(known, file=file, environ=os.environ, flags=flags)
    problems += exposed_secrets(laid)
    laid = _preset(laid) | laid
    try:
        settings = Settings.model_validate(nested(laid))
    except ValidationError as error:
        problems += impossible(error, laid, allowed_values())
    else:
        if not problems:
            return ReadSettings(settings, laid, file)
    raise UsageError("; ".join(problems)) from None
