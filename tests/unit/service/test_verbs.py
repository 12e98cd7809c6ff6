"""A verb of the bus is a message, a method and a row."""

from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from schemas.transport.wire import encode
from service.api import control
from service.api.control import Control
from service.api.messages import SceneRequest, SelectRequest, TopRequest
from service.api.staging import Staging
from service.api.verbs import VERBS, VerbType
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.contracts.test_listing_contract import commit
from tests.contracts.test_proposals_contract import two_days_in_a_street


class Parrot(Control):
    """A control with one verb more."""

    def answer_parrot(self, request: SceneRequest) -> SceneRequest:
        return request


def made(kind: type[Control], folder: Path) -> Control:
    return kind(
        settings=MiningSettings(bucket="memory://", artifacts="memory://"),
        ledger=World.on(open_store(folder)).ledger,
        staging=Staging(),
        on_scenes=lambda: None,
        on_selection=lambda _: None,
    )


def test_every_row_has_a_method_and_every_method_a_row() -> None:
    methods = {name.removeprefix("answer_") for name in vars(Control) if name.startswith("answer_")}
    assert methods == set(VERBS)


def test_one_row_and_one_method_make_a_verb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = VerbType(SceneRequest, SceneRequest)
    monkeypatch.setattr(control, "VERBS", {**VERBS, "parrot": row})
    asked = encode(SceneRequest(scene_id="a/lidar/1"))
    assert made(Parrot, tmp_path).answer("parrot", asked) == asked


def test_a_row_without_a_method_ends_the_service_at_its_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "VERBS", {**VERBS, "parrot": VerbType(None, None)})
    with pytest.raises(AttributeError, match="answer_parrot"):
        made(Control, tmp_path)


def test_rows_have_places_where_verdicts_are_requested_since_earlier_clients_refuse_them(
    tmp_path: Path,
) -> None:
    service = made(Control, tmp_path)
    commit(World.on(open_store(tmp_path)), *two_days_in_a_street())
    asked = {known: service.answer_top(TopRequest(verdicts=known)) for known in (True, False)}
    assert [row.place is None for row in asked[True].scenes] == [False] * 3
    assert "place" not in asked[False].scenes[0].model_dump()
    selection = service.answer_select(SelectRequest(budget=1, name="week", verdicts=True))
    assert "place" not in selection.scenes[0].model_dump()
