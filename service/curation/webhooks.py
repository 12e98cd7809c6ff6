"""Events of webhooks: what a receiver is sent, and the id by which it recognises a repeat. Pure.

Source of the form: Standard Webhooks, https://www.standardwebhooks.com.
"""

import base64
import hmac
import json
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Count, Finite, Kept, Said, StampNs, Text
from schemas.canonical import canonical_json
from schemas.score import Share
from service.curation.comparison import Comparison
from service.curation.comparison_report import gate_sentence, group_name
from service.curation.event_types import EventType
from service.curation.mode_rows import ModeRow

_FORM: Final = ConfigDict(frozen=True, extra="forbid")

SIGNATURE_VERSION: Final = "v1"

MOST_GROUPS: Final = 20
"""Groups that the event of a comparison names at most, the worst first."""


class SceneData(BaseModel):
    """A scene that is new, or newly reached the least score."""

    model_config = _FORM

    seq: Count = Field(description="Number of its event.")
    scene_id: Kept
    log_id: Kept
    vehicle: Kept
    software_version: Kept
    start_ns: StampNs
    end_ns: StampNs
    score: Share
    headline: Kept = Field(description="Of its first reason; empty without one.")
    sha256: Kept = Field(description="Digest of its record.")


class SelectionData(BaseModel):
    """A selection that was stored."""

    model_config = _FORM

    name: Kept
    strategy: Kept
    budget: Count
    scenes: Count = Field(description="Number of its scenes.")
    created_s: Finite


class ModeData(BaseModel):
    """A failure mode that was not there before."""

    model_config = _FORM

    mode: ModeRow
    noted_s: Finite = Field(description="When it was noticed, seconds since the Unix epoch.")


class GateData(BaseModel):
    """A comparison that the service answered, with a result that no earlier one had."""

    model_config = _FORM

    a: Said = Field(description="Version before.")
    b: Said = Field(description="Version to release.")
    passed: bool = Field(description="False: a group regressed beyond the tolerance.")
    result: Text = Field(description="The result in one sentence.")
    tolerance: Finite
    comparisons: Count = Field(description="Groups that were tested.")
    regressed: Count
    improved: Count
    regressed_groups: tuple[Said, ...] = Field(max_length=MOST_GROUPS)
    noted_s: Finite = Field(description="When it was compared, seconds since the Unix epoch.")


class WebhookEvent(BaseModel):
    """Body of one delivery; a repeat has the same bytes."""

    model_config = _FORM

    id: Said = Field(description="Also in the header `webhook-id`; a repeat has the same.")
    type: EventType
    data: SceneData | SelectionData | ModeData | GateData


@dataclass(frozen=True, slots=True)
class Due:
    """One number of a source.

    Attributes:
        number: The number, to which the cursor moves.
        event: What is sent; None: nothing.
    """

    number: int
    event: WebhookEvent | None


def scene_event(row: Any) -> WebhookEvent:
    """Make the event of a stored scene; its id depends on the scene and its record."""
    reasons = json.loads(row.reasons)
    data = SceneData(
        seq=row.seq,
        scene_id=row.scene_id,
        log_id=row.log_id,
        vehicle=row.vehicle,
        software_version=row.software_version,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        score=row.score,
        headline=str(reasons[0].get("headline", "")) if reasons else "",
        sha256=row.sha256,
    )
    return WebhookEvent(id=_id("scene", row.scene_id, row.sha256), type="scene.new", data=data)


def selection_event(row: Any) -> WebhookEvent:
    """Make the event of a stored selection."""
    data = SelectionData(
        name=row.name,
        strategy=row.strategy,
        budget=row.budget,
        scenes=row.scenes,
        created_s=row.created_s,
    )
    made = _id("selection", row.name, str(row.created_s))
    return WebhookEvent(id=made, type="selection.made", data=data)


def mode_event(body: str, noted_s: float) -> WebhookEvent:
    """Make the event of a failure mode, of its row as JSON."""
    mode = ModeRow.model_validate_json(body)
    made = _id("mode", mode.mode_id, str(noted_s))
    return WebhookEvent(id=made, type="mode.new", data=ModeData(mode=mode, noted_s=noted_s))


def gate_notice(found: Comparison) -> tuple[str, Mapping[str, object]]:
    """Return name and body of the notice of a comparison; equal results have the same name."""
    regressed = [row for row in found.groups if row.outcome == "regressed"]
    body = {
        "a": found.a.name,
        "b": found.b.name,
        "passed": found.passed,
        "result": gate_sentence(found),
        "tolerance": found.tolerance,
        "comparisons": found.comparisons,
        "regressed": found.regressed,
        "improved": found.improved,
        "regressed_groups": [group_name(row) for row in regressed[:MOST_GROUPS]],
    }
    return _id("gate", found.model_dump_json()), body


def gate_event(body: str, noted_s: float) -> WebhookEvent:
    """Make the event of a comparison, of the body of its notice as JSON."""
    data = GateData.model_validate(json.loads(body) | {"noted_s": noted_s})
    made = _id("gate", body, str(noted_s))
    return WebhookEvent(id=made, type="gate.compared", data=data)


def encoded(event: WebhookEvent) -> bytes:
    """Return the body of a delivery."""
    return canonical_json(event.model_dump(mode="json"))


def signature(secret: bytes, *, event_id: str, timestamp_s: int, body: bytes) -> str:
    """Return the value of the header `webhook-signature`: HMAC-SHA256 of id, time and body.

    Args:
        secret: Shared with the receiver, 24 to 64 bytes.
        event_id: Value of `webhook-id`.
        timestamp_s: Value of `webhook-timestamp`, seconds since the Unix epoch.
        body: Body of the delivery.
    """
    signed = b".".join((event_id.encode(), str(timestamp_s).encode(), body))
    digest = hmac.new(secret, signed, sha256).digest()
    return f"{SIGNATURE_VERSION},{base64.b64encode(digest).decode()}"


def _id(*parts: str) -> str:
    digest = sha256("\n".join(parts).encode()).hexdigest()
    return f"msg_{digest[:32]}"
