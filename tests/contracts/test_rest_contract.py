"""The REST API on real states: the answers of the verbs, by SQLite and by PostgreSQL."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from pydantic import BaseModel

from schemas.canonical import sha256
from schemas.errors import PermanentError
from schemas.transport.wire import encode
from service.api.messages import RatesReply, SelectionsReply, TopReply
from service.api.routes import PAGE_ROUTES, ROUTES
from service.client import ControlClient, Counterpoint
from service.curation.activity import ActivityRequest
from service.curation.listing import ScenesRequest
from service.curation.rates import RatesRequest
from service.curation.verdicts import AgreementRequest, VerdictsRequest
from service.errors import NothingFoundError
from service.http.problems import ProblemDetails
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.served_api import ServedApi, served_api
from tests.unit.service.mined_state import mined_state

UNKNOWN = "car-7/a/lidar/1"
EVERY = {**ROUTES, **PAGE_ROUTES}


def id_of(scene_id: str) -> str:
    return quote(scene_id, safe="")


ASKED = (
    ("/scenes?most=100000", 422, "most: "),
    ("/scenes?most=seven", 422, "most: "),
    ("/scenes?min_score=nan", 422, "min_score: "),
    ("/scenes?within_m=nan", 422, "within_m: "),
    ("/scenes?within_m=1e9", 422, "within_m: "),
    ("/scenes?beyond_m=-1", 422, "beyond_m: "),
    ("/scenes?beyond_m=50&within_m=30", 422, "within_m: Input should be greater than beyond"),
    ("/scenes?after=AAAA", 400, "no cursor of a listing by score"),
    (f"/scenes?after={'x' * 5000}", 422, "after: "),
    ("/scenes?after=WyJzY29yZSIsIDFlNDAwLCAxLCAxXQ==", 400, "no cursor"),
    ("/scenes?colour=red", 422, "colour: "),
    ("/scenes?vehicle=a%00b&judged=mine", 400, "reviewer"),
    ("/scenes?since_ns=-1", 422, "since_ns: "),
    ("/scenes?selection=none", 404, "no selection 'none'"),
    (f"/scenes/{id_of(UNKNOWN)}", 404, "no current scene"),
    (f"/scenes/{id_of(UNKNOWN)}/overlay", 404, "no current scene"),
    ("/scenes/a%00b", 422, "scene_id: "),
    (f"/scenes/{'x' * 5000}", 422, "scene_id: "),
    ("/scenes/..%2F..%2Fetc%2Fpasswd", 404, "no current scene"),
    ("/selections/none", 404, "no selection 'none'"),
    ("/verdicts?before=99999999999999999999", 422, "before: "),
    ("/rates?by=colour", 422, "by: "),
    ("/ranking?most=0", 422, "most: "),
    ("/nothing", 404, "no such resource"),
    ("/undos", 405, "method"),
)
"""Path, status, and part of the sentence."""

SENT = (
    ("/selections", b"[" * 100_000, 400, "one JSON object"),
    ("/selections", b'{"budget":' + b"9" * 6000 + b"}", 400, "one JSON object"),
    ("/selections", b'{"budget": 1e400}', 422, "budget: "),
    ("/selections", b'{"budget": NaN}', 422, "budget: "),
    ("/selections", b'{"budget": 1, "terms": {"filters": {"within_m": 0}}}', 422, "within_m: "),
    ("/selections", b'{"budget": 1, "name": "\\ud800"}', 422, "name: "),
    ("/selections", b'{"budget": 0}', 422, "budget: "),
    ("/selections", b'{"budget": 1, "terms": {"strategy": "luck"}}', 400, "luck"),
    ("/selections", b'{"budget": 1, "scenes": ["none"]}', 404, "none"),
    ("/selections", b'"text"', 400, "one JSON object"),
    ("/selections", b"", 400, "one JSON object"),
    ("/selections", b"\xff\xfe", 400, "one JSON object"),
    ("/selections", b"x" * (2**20 + 1), 413, "1048576 bytes"),
    ("/verdicts", b'{"verdict": 7}', 422, "scene_id: "),
    ("/verdicts", b"{}", 422, "scene_id: "),
    ("/exports", b'{"selection": "none", "format": "json"}', 400, "no folder for exports"),
    ("/exports", b'{"selection": "none"}', 422, "format: "),
    ("/exports/0/stop", b"{}", 422, "number: "),
    ("/undos", b'{"reviewer": "Ada"}', 404, "no verdict"),
)
"""Path, body, status, and part of the sentence."""


class RestContract:
    """Check the answers of the REST API, on each database."""

    url = ""

    def make_store(self) -> Any:
        raise NotImplementedError

    @pytest.fixture
    def api(self, tmp_path: Path) -> Iterator[ServedApi]:
        mined_state(tmp_path, store=self.make_store())
        with served_api(tmp_path, database=self.url or None) as served:
            yield served

    def test_every_answer_is_the_one_of_its_verb(self, api: ServedApi) -> None:
        source = api.source
        best = source.top(1)[0].scene_id
        api.client.select(2, name="week 47")
        replies: dict[str, BaseModel] = {
            "/scenes?min_score=0.1&most=3": source.scenes(ScenesRequest(min_score=0.1, most=3)),
            "/scenes?within_m=30&beyond_m=3": source.scenes(ScenesRequest(within_m=30, beyond_m=3)),
            "/ranking?most=4": TopReply(scenes=tuple(source.top(4))),
            f"/scenes/{id_of(best)}": source.scene(best),
            "/selections": SelectionsReply(selections=tuple(source.selections())),
            "/selections/week%2047": source.selection("week 47"),
            "/modes": source.modes(),
            "/rates?by=vehicle": RatesReply(
                rows=tuple(source.rates(RatesRequest(by="vehicle", verdicts=True)))
            ),
            "/activity?per=hour": source.activity(ActivityRequest(per="hour")),
            "/verdicts": source.verdicts(VerdictsRequest()),
            "/agreement": source.agreement(AgreementRequest()),
            "/choices": source.choices(),
        }
        for path, reply in replies.items():
            answer = api.get(path)
            assert answer.status_code == 200, answer.text
            assert answer.content == encode(reply), path

    def test_pages_follow_each_other_to_the_last(self, api: ServedApi) -> None:
        seen, path = [], "/scenes?most=4"
        while path:
            answer = api.get(path)
            seen += [row["scene_id"] for row in answer.json()["rows"]]
            following = answer.links.get("next")
            path = following["url"].removeprefix("/api/v1") if following else ""
        assert len(seen) == len(set(seen)) == api.get("/scenes").json()["total"]
        near = api.client.scenes(within_m=13, beyond_m=12)
        assert [row.scene_id for row in near] == [
            row.scene_id for row in api.client.scenes(kind="only_predictive_dynamic")
        ]
        assert list(api.client.scenes(within_m=12)) == []
        rows = api.client.scenes(most=4)
        assert [row.scene_id for row in rows] == seen
        assert rows[2:4] == list(rows)[2:4]

    def test_a_write_with_a_key_is_stored_once(self, api: ServedApi) -> None:
        best = api.source.top(1)[0].scene_id
        body = {"scene_id": best, "reviewer": "Ada", "verdict": "supervised"}
        first, again = (api.post("/verdicts", body, key="one") for _ in range(2))
        assert first.status_code == again.status_code == 201
        assert first.content == again.content
        assert len(api.client.verdicts()) == 1
        assert api.post("/verdicts", body | {"key": "other"}, key="one").status_code == 400
        undone = [api.post("/undos", {"reviewer": "Ada"}, key="undo") for _ in range(2)]
        assert [answer.status_code for answer in undone] == [201, 201]
        assert (len(api.client.verdicts()), len(api.client.verdicts(current=False))) == (0, 2)

    def test_a_selection_with_a_key_is_made_once(self, api: ServedApi) -> None:
        made, again = (api.post("/selections", {"budget": 2}, key="one") for _ in range(2))
        assert (made.status_code, again.status_code) == (201, 200)
        assert made.json() == again.json()
        assert made.headers["location"] == f"/api/v1/selections/{made.json()['name']}"
        assert api.post("/selections", {"budget": 3}, key="one").status_code == 409
        assert len(api.client.selections()) == 1
        chosen = api.client.selection(made.json()["name"])
        assert all(
            each.scene.scene_id not in {scene.scene_id for scene in chosen.scenes}
            for each in api.client.propose(2)
        )
        given = [api.source.top(1)[0].scene_id]
        assert api.client.select(1, name="by hand", scenes=given).scenes[0].scene_id == given[0]
        with pytest.raises(PermanentError, match="'by hand' exists"):
            api.client.select(2, name="by hand")

    def test_the_client_has_the_answers_of_the_reader(self, api: ServedApi) -> None:
        client, source = api.client, api.source
        best = source.top(1)[0].scene_id
        assert list(client.top(None)) == source.top()
        assert client.scene(best) == source.scene(best)
        assert client.client.record(best) == source.record(best)
        assert client.client.overlay(best) == source.overlay(best)
        assert client.overlay(best).points_cm.shape == (3, 3)
        by_ranges, direct = (each.overlay_file(best) for each in (client.client, source))
        assert by_ranges.view(0) == direct.view(0)
        assert by_ranges.header == direct.header
        assert list(client.rates("vehicle")) == source.rates(RatesRequest(by="vehicle"))
        assert list(client.modes()) == list(source.modes().modes)
        assert client.choices() == source.choices()
        assert client.status().frames == source.status().frames
        track = client.scene(best).tracks[0].track_id
        judged = client.judge(best, "supervised", reviewer="Ada", track_id=track, note="a rim")
        assert list(client.verdicts(reviewer="Ada")) == [judged]
        assert client.agreement().scenes == 1
        assert client.undo(reviewer="Ada", scene_id=best, track_id=track).verdict == "withdrawn"

    def test_an_overlay_is_sent_by_ranges_and_once(self, api: ServedApi) -> None:
        best = api.source.top(1)[0].scene_id
        path = f"/scenes/{id_of(best)}/overlay"
        whole = api.source.overlay(best)
        answer = api.get(path)
        etag = answer.headers["etag"]
        assert (answer.content, etag) == (whole, f'"{sha256(api.source.record(best))}"')
        for given, expected in (
            ("bytes=0-9", whole[:10]),
            ("bytes=10-", whole[10:]),
            ("bytes=-7", whole[-7:]),
            (f"bytes=5-{10**14}", whole[5:]),
        ):
            part = api.get(path, headers={"range": given})
            assert (part.status_code, part.content) == (206, expected), given
            assert part.headers["content-range"].endswith(f"/{len(whole)}")
        assert api.get(path, headers={"range": "bytes=99999-"}).status_code == 416
        assert api.get(path, headers={"range": "bytes=1-2, 4-5"}).content == whole
        assert api.get(path, headers={"if-none-match": etag}).status_code == 304
        assert api.get(path, headers={"if-match": '"other"'}).status_code == 412
        stale = {"range": "bytes=0-9", "if-range": '"other"'}
        assert api.get(path, headers=stale).content == whole
        assert httpx.head(f"{api.url}/api/v1{path}").headers["content-length"] == str(len(whole))

    def test_what_is_not_possible_is_one_sentence(self, api: ServedApi) -> None:
        for path, status, words in ASKED:
            answer = api.get(path)
            assert (answer.status_code, words in is_problem(answer)) == (status, True), answer.text

    def test_a_hostile_body_is_one_sentence(self, api: ServedApi) -> None:
        headers = {"content-type": "application/json"}
        for path, body, status, words in SENT:
            answer = httpx.post(f"{api.url}/api/v1{path}", content=body, headers=headers)
            assert (answer.status_code, words in is_problem(answer)) == (status, True), answer.text

    def test_a_body_that_is_longer_than_it_states_is_refused(self, api: ServedApi) -> None:
        def chunks() -> Iterator[bytes]:
            for _ in range(40):
                yield b" " * 2**16

        headers = {"content-type": "application/json"}
        answer = httpx.post(f"{api.url}/api/v1/selections", content=chunks(), headers=headers)
        assert (answer.status_code, "bounds" in is_problem(answer)) == (400, True)

    def test_a_request_of_another_site_or_host_is_refused(self, api: ServedApi) -> None:
        foreign = {"origin": "https://evil.example", "sec-fetch-site": "cross-site"}
        answer = httpx.post(f"{api.url}/api/v1/undos", json={"reviewer": "a"}, headers=foreign)
        assert (answer.status_code, bool(is_problem(answer))) == (403, True)
        answer = api.get("/scenes", headers={"host": "evil.example"})
        assert (answer.status_code, bool(is_problem(answer))) == (421, True)

    def test_the_errors_of_the_client_are_those_of_the_reader(self, api: ServedApi) -> None:
        for source in (api.client.client, api.source):
            with pytest.raises(NothingFoundError, match="no current scene"):
                source.scene(UNKNOWN)
            with pytest.raises(NothingFoundError, match="no current scene"):
                source.overlay(UNKNOWN)

    def test_the_document_lists_every_route_with_a_bound_on_every_parameter(
        self, api: ServedApi
    ) -> None:
        document = api.get("/openapi.json").json()
        listed = {
            about["operationId"]: (method.upper(), path)
            for path, methods in document["paths"].items()
            for method, about in methods.items()
        }
        assert listed == {verb: (each.method, each.path) for verb, each in EVERY.items()}
        parameters = [
            (each["name"], kind)
            for methods in document["paths"].values()
            for about in methods.values()
            for each in about.get("parameters", ())
            for kind in each["schema"].get("anyOf", [each["schema"]])
        ]
        assert parameters
        assert [each for each in parameters if not is_bounded(each[1])] == []

    def test_an_address_that_no_route_matches_is_answered_by_problem_details(
        self, api: ServedApi
    ) -> None:
        answer = api.get("/scenes/one%0Atwo")
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"

    def test_the_document_names_the_media_type_of_errors_and_both_ends_of_a_selection(
        self, api: ServedApi
    ) -> None:
        paths = api.get("/openapi.json").json()["paths"]
        errors = [
            about["responses"]["default"]["content"]
            for methods in paths.values()
            for about in methods.values()
        ]
        assert {kind for content in errors for kind in content} == {"application/problem+json"}
        assert {"200", "201"} <= paths["/selections"]["post"]["responses"].keys()

    def test_the_page_of_the_routes_has_nothing_inline_and_nothing_foreign(
        self, api: ServedApi
    ) -> None:
        answer = api.get("/")
        assert answer.headers["content-security-policy"].startswith("default-src 'none'")
        for forbidden in (" style=", "<style", "<script", "https://", "//cdn"):
            assert forbidden not in answer.text
        for verb, each in EVERY.items():
            assert f"/api/v1{each.path}" in answer.text, verb
        for path in ("/static/app.css", "/static/api.css"):
            assert httpx.get(f"{api.url}{path}").status_code == 200


def is_bounded(kind: dict[str, Any]) -> bool:
    match kind.get("type"):
        case "string":
            return bool({"maxLength", "enum", "const"} & kind.keys())
        case "integer" | "number":
            return bool({"maximum", "exclusiveMaximum"} & kind.keys())
    return kind.get("type") in ("boolean", "null") or "$ref" in kind


def is_problem(answer: httpx.Response) -> str:
    """Return the sentence of an error, after its form was checked."""
    assert answer.headers["content-type"] == "application/problem+json"
    details = ProblemDetails.model_validate(answer.json())
    assert details.status == answer.status_code
    assert "\n" not in details.detail
    return details.detail


class TestOnSqlite(OnSqlite, RestContract):
    """By a file."""


class TestOnPostgres(OnPostgres, RestContract):
    """By a server."""


def test_a_client_says_what_is_no_address_and_what_does_not_answer() -> None:
    for wrong in ("", "nonsense", "ftp://host", "http://", "http://host?x=1"):
        with pytest.raises(PermanentError, match="no address"):
            Counterpoint(wrong)
    assert isinstance(Counterpoint("tcp/127.0.0.1:7447").client, ControlClient)
