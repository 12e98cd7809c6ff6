"""Routes of the audit log: note an export, and read who did what."""

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from service.curation.audit import AuditedReply, AuditRequest, ExportedRequest
from service.http.context import answer, next_page, route, source_of

router = APIRouter(tags=["audit"])


@route(router, "exported", summary="Note an export", status_code=201)
def exported(request: Request, asked: ExportedRequest) -> Response:
    """Store in the audit log that a selection is exported, before anything leaves."""
    return answer(AuditedReply(ordinal=source_of(request).exported(asked)), status=201)


@route(router, "audit", summary="Read the audit log")
def audit(request: Request, asked: Annotated[AuditRequest, Query()]) -> Response:
    """List who selected, judged, retried and exported what, latest first, page by page."""
    found = source_of(request).audit(asked)
    is_last = len(found.rows) < asked.most
    headers = {} if is_last else next_page(request, before=found.rows[-1].ordinal)
    return answer(found, headers=headers)
