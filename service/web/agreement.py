"""Agreement page: pace of each reviewer, Cohen's kappa of each pair, conflicts, precision."""

from urllib.parse import quote

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from service.curation.verdicts import FEW_ITEMS, AgreementRequest, VerdictsRequest
from service.errors import UsageError
from service.web.context import render, source_of, visitor_of
from service.web.phrases import interval

router = APIRouter()


@router.get("/agreement")
def agreement(request: Request) -> Response:
    """Answer with the sums over all verdicts, or those on a selection, and the latest verdicts."""
    source = source_of(request)
    selection = request.query_params.get("selection", "").strip()
    found = source.agreement(AgreementRequest(selection=selection or None))
    before = request.query_params.get("before", "")
    if before and not (before.isascii() and before.isdecimal() and len(before) < 19):
        raise UsageError("before is the number of a verdict")
    latest = source.verdicts(
        VerdictsRequest(current=False, most=25, before=int(before) if before else None)
    )
    precision = found.precision
    return render(
        request,
        "agreement.html",
        section="agreement",
        found=found,
        selection=selection,
        selections=[each.name for each in reversed(source.selections())],
        reviewer_name=visitor_of(request).reviewer,
        few=FEW_ITEMS,
        pairs=sorted(found.pairs, key=lambda pair: (-pair.items, pair.one, pair.other)),
        latest=latest,
        precision=""
        if precision.share is None or precision.low is None or precision.high is None
        else interval(precision.share, precision.low, precision.high),
        address=lambda scene_id: f"/scene?id={quote(scene_id, safe='')}",
    )
