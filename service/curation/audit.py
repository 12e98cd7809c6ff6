"""Rows of the audit log: who did what, and when."""

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Count, Name, Seconds, Text

MAX_AUDIT_ASKED: Final = 1000
"""Rows of one page of the audit log."""

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")


class AuditRow(BaseModel):
    """One act: a selection, a verdict, its undo, a retry, or an export."""

    model_config = _STRICT

    ordinal: Count = Field(description="Number of the row, without a gap.")
    at_s: Seconds = Field(description="Seconds since the Unix epoch.")
    name: Text = Field(description="Name by certificate or token; empty: none proves who it was.")
    says: Text = Field(description="Name that the asker gave itself.")
    via: Text = Field(description="bus, or command.")
    what: Text = Field(description="The verb.")
    detail: Text = Field(description="What was done, JSON.")
    is_whole: bool = Field(
        default=True, description="False: this row or the one before it was changed or deleted."
    )


class AuditRequest(BaseModel):
    """Request for a page of the audit log, latest first."""

    model_config = _STRICT

    most: int = Field(default=100, ge=1, le=MAX_AUDIT_ASKED, description="Rows at most.")
    before: Count | None = Field(default=None, description="Only rows with a smaller number.")


class AuditReply(BaseModel):
    """A page of the audit log, latest first."""

    model_config = _STRICT

    rows: tuple[AuditRow, ...] = Field(max_length=MAX_AUDIT_ASKED)


class AuditedReply(BaseModel):
    """Number of the row that was stored."""

    model_config = _STRICT

    ordinal: Count


class ExportedRequest(BaseModel):
    """Notice of an export, stored in the audit log before anything leaves."""

    model_config = _STRICT

    selection: Name
    form: Name = Field(description="Name of the format.")
    scenes: Count = Field(description="Scenes of the selection.")
    place: Text = Field(default="", description="Folder that is written.")
