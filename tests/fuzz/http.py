"""Asks the pages of real processes thousands of requests: `python -m tests.fuzz.http --examples N`.

The REST API is asked by its own OpenAPI description, with requests that fit it and requests that
do not (schemathesis). The pages of the service are asked with odd paths, parameters and methods.
The requests of a seed are the same in every run.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import requests
import schemathesis
from hypothesis import strategies as st
from schemathesis import Case, GenerationMode
from schemathesis.checks import CHECKS, load_all_checks
from schemathesis.core.failures import FailureGroup

from tests.fuzz.asked_pages import PATIENCE_S, AskedPages, HttpReport, asked_pages
from tests.fuzz.parts import run_part

MOST_MB: Final = 400
"""Memory of a page or service, whatever is asked of it."""

PART: Final = 25
"""Requests of one operation in a row; more make hypothesis remember too much."""

API_SHARE: Final = 0.7
"""Share of requests that the REST API gets; the rest goes to the pages of the service."""

CHECKED: Final = (
    "status_code_conformance",
    "content_type_conformance",
    "response_schema_conformance",
)
"""Checks of an answer against the description, in addition to the status."""

JOBS: Final = "POST /exports"
"""Operation that starts processes; it is asked in one part only."""

PATHS: Final = ("/metrics", "/healthz", "/readyz", "/rates", "/", "/rates/", "/%00", "/../rates")
METHODS: Final = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "TRACE", "GET\t", "BREW")
WORDS: Final = ("by", "since", "until", "hour", "vehicle", "7d", "2026-01-01", "-1", "9" * 30)
ODD: Final = st.one_of(st.sampled_from(WORDS), st.text(max_size=40))


def main() -> int:
    """Ask, and say how it went; 1 if a request failed."""
    asked = argparse.ArgumentParser(prog="python -m tests.fuzz.http")
    asked.add_argument("--examples", type=int, default=2000, help="how many requests")
    asked.add_argument("--seed", type=int, default=0, help="of the first part")
    how = asked.parse_args()
    with tempfile.TemporaryDirectory(prefix="asked-") as folder:
        report = ask_pages(Path(folder), examples=how.examples, first_seed=how.seed)
    for line in report.lines():
        sys.stdout.write(line + "\n")
    return int(bool(report.failures) or max(report.peak_mb.values()) > MOST_MB)


def ask_pages(folder: Path, *, examples: int, first_seed: int = 0) -> HttpReport:
    """Send so many requests to real pages.

    Args:
        folder: For states and logs.
        examples: Number of requests.
        first_seed: Seed of the first part.
    """
    load_all_checks()
    with asked_pages(folder) as pages:
        schema = schemathesis.openapi.from_url(f"{pages.page}/api/v1/openapi.json")
        asked = [
            (operation, mode)
            for operation in _operations(schema)
            for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE)
        ]
        part = first_seed
        while pages.report.count < examples:
            began = pages.report.count
            for operation, mode in asked[:]:
                before = pages.report.count
                cases = operation.as_strategy(generation_mode=mode)
                run_part(cases, lambda case: _ask_case(pages, case), examples=PART, of_seed=part)
                if operation.label == JOBS or pages.report.count == before:
                    asked.remove((operation, mode))  # nothing about it can be wrong
            most = round((pages.report.count - began) * (1 / API_SHARE - 1))
            odd = _odd_requests()
            run_part(odd, lambda made: _ask_service(pages, made), examples=most, of_seed=part)
            pages.look()
            part += 1
        return pages.report


def _operations(schema: Any) -> list[Any]:
    return [found.ok() for found in schema.get_all_operations()]


def _ask_case(pages: AskedPages, case: Case[Any]) -> None:
    label = case.operation.label
    said = f"{case.method} {case.formatted_path} {case.query} {str(case.body)[:300]}"

    def send() -> requests.Response:
        kwargs = case.as_transport_kwargs(base_url=f"{pages.page}/api/v1")
        kwargs.pop("cookies", None)
        return requests.request(**kwargs, timeout=PATIENCE_S)

    try:
        answer = pages.report.ask(label, said, send)
    except (ValueError, UnicodeError):  # a header that no client can send
        return
    if answer is None:
        return
    checked: list[Any] = [CHECKS.get_one(name) for name in CHECKED]
    try:
        case.validate_response(answer, checks=checked)
    except FailureGroup as found:
        for each in found.exceptions:
            pages.report.fail(f"{label}: {answer.status_code}: {type(each).__name__}", said)


def _odd_requests() -> st.SearchStrategy[tuple[str, bytes]]:
    """Make the bytes of requests to the pages of a service, by the path that they name."""
    queries = st.lists(st.tuples(ODD, ODD), max_size=4).map(
        lambda pairs: urlencode(pairs, errors="replace") if pairs else ""
    )
    texts = st.one_of(queries, st.text(max_size=200), st.just("by=" + "x" * 20_000))
    headers = st.lists(st.tuples(ODD, ODD), max_size=3)
    return st.builds(_request, st.sampled_from(METHODS), st.sampled_from(PATHS), texts, headers)


def _request(
    method: str, path: str, query: str, headers: list[tuple[str, str]]
) -> tuple[str, bytes]:
    lines = [f"{method} {path}?{query} HTTP/1.1", "Host: 127.0.0.1", "Connection: close"]
    lines += [f"{name}: {text}" for name, text in headers]
    return path, "\r\n".join([*lines, "", ""]).encode("utf-8", "replace")


def _ask_service(pages: AskedPages, odd: tuple[str, bytes]) -> None:
    path, sent = odd
    pages.report.ask_raw(f"service {path}", pages.service_port, sent)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
