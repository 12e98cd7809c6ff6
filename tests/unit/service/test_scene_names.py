"""Short names of scenes tell them apart as they are listed, and are found again."""

from contextlib import closing
from pathlib import Path

import pytest

from service.cli.main import main
from service.curation.ranking import RankedScene
from service.curation.scene_names import is_short_name, named, short_names
from service.errors import NothingFoundError, UsageError
from service.store.engine import open_store
from tests.contracts.ledger_world import World

BEGIN_NS = 1_772_442_064_050_000_000
BEGINS = "2026-03-02T09:01:04.0"


def row(log_id: str, *, rank: int = 1, lidar: str = "lidar.top", after_s: int = 0) -> RankedScene:
    start_ns = BEGIN_NS + after_s * 10**9
    return RankedScene(
        rank=rank,
        scene_id=f"{log_id}/{lidar}/{start_ns}",
        log_id=log_id,
        start_ns=start_ns,
        end_ns=start_ns + 19 * 10**8,
        score=0.5,
        sha256="0" * 64,
    )


@pytest.mark.parametrize(
    ("rows", "names"),
    [
        pytest.param(
            [row("car-1/today/a"), row("car-1/today/b", after_s=61)],
            [f"a@{BEGINS}", "b@2026-03-02T09:02:05.0"],
            id="the last part is enough",
        ),
        pytest.param(
            [row("car-1/today/a"), row("car-2/today/a"), row("b")],
            [f"car-1/today/a@{BEGINS}", f"car-2/today/a@{BEGINS}", f"b@{BEGINS}"],
            id="as many parts as are needed",
        ),
        pytest.param(
            [row("x/a"), row("x/xa")], [f"a@{BEGINS}", f"xa@{BEGINS}"], id="parts are whole"
        ),
        pytest.param([row("a"), row("x/a")], [f"a@{BEGINS}", f"x/a@{BEGINS}"], id="a whole id"),
        pytest.param(
            [row("a"), row("a", lidar="lidar.left"), row("a", after_s=2)],
            [f"a/lidar.top@{BEGINS}", f"a/lidar.left@{BEGINS}", "a@2026-03-02T09:01:06.0"],
            id="two lidars",
        ),
    ],
)
def test_names_tell_what_is_listed_apart(rows: list[RankedScene], names: list[str]) -> None:
    assert list(short_names(rows).values()) == names
    assert all(is_short_name(name) for name in names)
    assert [named(name, rows) for name in names] == rows


def test_a_name_of_a_shorter_listing_may_mean_several() -> None:
    rows = [row("car-1/a", rank=3), row("car-2/a", rank=8)]
    (name,) = short_names(rows[:1]).values()
    with pytest.raises(UsageError, match=r"matches several scenes.*rank: 3 \(car-1/a.*8 \(car-2"):
        named(name, rows)
    with pytest.raises(NothingFoundError, match="no current scene"):
        named("a@2026-03-02T09:01:05.0", rows)


def test_an_id_is_no_short_name() -> None:
    assert not is_short_name(row("car@home/a").scene_id)


def test_show_takes_a_rank_and_a_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("state/artifacts").mkdir(parents=True)
    with closing(open_store(Path("state"))) as store:
        world = World.on(store)
        world.listed("car-1/drive")
        world.mine_all()
        ranking = world.ledger.ranking()
    for said, scene in (
        ("2", ranking[1]),
        (short_names(ranking)[ranking[2].scene_id], ranking[2]),
        (ranking[0].scene_id, ranking[0]),
    ):
        assert main(["show", said, "--state", "state", "--out", "a.png"]) == 1
        assert f"no overlay of {scene.scene_id}" in capsys.readouterr().err, "nobody drew these"
    for said in ("0", "999", "x@2026-03-02T09:01:04.0", "x"):
        assert main(["show", said, "--state", "state", "--out", "a.png"]) == 1
        assert "`counterpoint top` lists them" in capsys.readouterr().err
