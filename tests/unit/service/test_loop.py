"""`bench loop`: orders of choice, curves and figure, and a small loop that is run and resumed."""

import json
from pathlib import Path

import numpy as np
import pytest

from service.cli.main import main
from service.evaluation.loop_figure import LoopPoint, figure_of, scenes_to_reach
from service.evaluation.loop_orders import (
    BY_SCORE,
    ENTROPY,
    ORDERS,
    POINT_SHARE,
    RANDOM,
    SceneKey,
    chosen_by,
)
from service.evaluation.mined_fleet import FleetScene, fleet_of
from tests.unit.service.test_bench_selection import mined
from workers.lab.loop.model import (
    STEPS,
    StreetCount,
    held_out_street,
    judge,
    sets_of,
    taught_street,
    teach,
)
from workers.lab.loop.streets import FLEET, TAUGHT, UNKNOWN, World, draw_street
from workers.lab.simulation.models.kinds import StreetClass

SELECTION = "best-distinct"


def fleet_and_entropy() -> tuple[list[FleetScene], dict[str, float]]:
    """Two logs of four scenes; the last scene is the least sure one, the third differs most."""
    logs = []
    for number in range(2):
        log = mined(number, [0.9 - 0.1 * number, 0.5, 0.4, 0.02], failing=[0])
        shares = [0.1, 0.2, 0.9 - 0.1 * number, 0.3]
        scenes = [
            scene.model_copy(update={"views": {"point_share": share}})
            for scene, share in zip(log.scenes, shares, strict=True)
        ]
        logs.append(log.model_copy(update={"scenes": tuple(scenes)}))
    entropy = {scene.scene_id: 0.1 * scene.cell for log in logs for scene in log.scenes}
    return fleet_of(logs), entropy


def key(log: int, cell: int) -> SceneKey:
    return SceneKey(f"sim-0{log}/day/street", cell)


def test_each_order_chooses_by_its_own_measure() -> None:
    fleet, entropy = fleet_and_entropy()

    def chosen(order: str, budget: int, seed: int = 1) -> list[SceneKey]:
        return chosen_by(order, fleet, entropy, budget=budget, seed=seed)

    assert chosen(BY_SCORE, 2) == [key(0, 0), key(1, 0)]
    assert chosen(ENTROPY, 2) == [key(0, 3), key(1, 3)]
    assert chosen(POINT_SHARE, 2) == [key(0, 2), key(1, 2)]
    assert chosen(RANDOM, 4)[:2] == chosen(RANDOM, 2)
    assert chosen(RANDOM, 8) != chosen(RANDOM, 8, seed=2)
    assert set(chosen(RANDOM, 8)) == set(chosen(BY_SCORE, 8))


def test_the_default_selection_leaves_out_scenes_without_a_reason() -> None:
    fleet, entropy = fleet_and_entropy()
    chosen = chosen_by(SELECTION, fleet, entropy, budget=8, seed=1)
    assert key(0, 0) in chosen
    assert key(0, 3) not in chosen
    assert len(chosen) < len(chosen_by(BY_SCORE, fleet, entropy, budget=8, seed=1)) == 8


def test_the_scenes_to_reach_a_value_are_interpolated() -> None:
    curve = [(0, 0.1), (2, 0.3), (4, 0.2), (8, 0.6)]
    assert scenes_to_reach(curve, 0.2) == pytest.approx(1.0)
    assert scenes_to_reach(curve, 0.4) == pytest.approx(6.0)
    assert scenes_to_reach(curve, 0.05) == 0.0
    assert scenes_to_reach(curve, 0.7) is None


def scored(high: int, low: int) -> tuple[int, ...]:
    """Counts of pixels of which some have a high score, and some a low one."""
    counts = [0] * STEPS
    counts[10], counts[-10] = low, high
    return tuple(counts)


def point(order: str, budget: int, seed: int, unknown_high: int) -> LoopPoint:
    """A point with two held-out streets, the second in rain.

    A fiftieth of the static pixels of either street has a score as high as the movers found.
    """
    count = StreetCount(
        unknown=True,
        rain=False,
        known_moving=scored(50, 0),
        unknown_moving=scored(unknown_high, 100 - unknown_high),
        static=scored(20, 980),
    )
    wet = StreetCount(
        unknown=False,
        rain=True,
        known_moving=scored(10, 10),
        unknown_moving=scored(0, 0),
        static=scored(4, 196),
    )
    return LoopPoint(
        order=order, budget=budget, seed=seed, scenes=budget, with_unknown=0, streets=(count, wet)
    )


def test_curves_and_figure_follow_from_the_counts() -> None:
    points = [point("", 0, seed, 0) for seed in (1, 2)]
    for seed in (1, 2):
        points += [point(RANDOM, 4, seed, 10), point(RANDOM, 8, seed, 40)]
        points += [point(BY_SCORE, 4, seed, 80), point(BY_SCORE, 8, seed, 90)]
    figure = figure_of(points, fleet_scenes=20)
    rows = {(row.order, row.budget): row for row in figure.rows}
    assert figure.seeds == (1, 2)
    assert figure.budgets == (4, 8)
    assert rows["", 0].found["unknown"] == 0.0
    assert rows[BY_SCORE, 4].found["unknown"] == pytest.approx(0.8)
    assert rows[BY_SCORE, 4].found["moving"] == pytest.approx(140 / 170, abs=1e-4)
    assert rows[BY_SCORE, 4].found["rain"] == 0.5
    reached = {(each.order, each.measure): each for each in figure.reach}
    assert (RANDOM, "unknown") not in reached
    found = reached[BY_SCORE, "unknown"]
    assert found.target == pytest.approx(0.4)
    assert found.scenes == pytest.approx(2.0)
    assert found.share == pytest.approx(0.25)
    low, high = rows[BY_SCORE, 4].interval["moving"]
    assert low <= 0.5 < 140 / 170 <= high + 1e-4


def test_the_difference_to_random_is_taken_draw_by_draw() -> None:
    points = [point("", 0, 1, 0), point(RANDOM, 4, 1, 10), point(BY_SCORE, 4, 1, 80)]
    rows = {row.order: row for row in figure_of(points, fleet_scenes=20).rows}
    assert rows[""].over_random == {}
    assert rows[RANDOM].over_random == {}
    assert rows[BY_SCORE].over_random["rain"] == (0.0, 0.0)
    low, high = rows[BY_SCORE].over_random["unknown"]
    assert (
        low >= 0.0
    )  # of draws without the only street that has the unknown classes: no difference
    assert high == pytest.approx(0.7)


def test_equally_cautious_models_are_compared() -> None:
    """A model that gives every pixel a higher score finds no more than before."""

    def found(shift: int) -> float:
        def moved(counts: tuple[int, ...]) -> tuple[int, ...]:
            return counts[-shift:] + counts[:-shift] if shift else counts

        before = point("", 0, 1, 40)
        streets = tuple(
            street.model_copy(
                update={
                    name: moved(getattr(street, name))
                    for name in ("known_moving", "unknown_moving", "static")
                }
            )
            for street in before.streets
        )
        [row] = figure_of([before.model_copy(update={"streets": streets})], fleet_scenes=2).rows
        return row.found["moving"]

    assert found(0) == found(9) == pytest.approx(100 / 170, abs=1e-4)


def test_each_image_is_drawn_equally_often(tmp_path: Path) -> None:
    made = taught_street(tmp_path / "street", 0, seed=1)
    few = [each.part(slice(1)) for each in made]
    sets = sets_of([*made, *few])
    assert {each.weight / len(each.images.motion) for each in sets} == {1.0}


def test_each_pixel_of_a_street_counts_once_when_a_model_is_judged(tmp_path: Path) -> None:
    taught = taught_street(tmp_path / "street", 0, seed=1)
    held_out = held_out_street(tmp_path / "held-out", 0, seed=1)
    model = teach(taught, [], steps=2, seed=1, out=tmp_path / "first")
    [count] = judge(model, [held_out])
    motion = held_out.images.motion
    moving = np.add(count.known_moving, count.unknown_moving)
    assert len(count.static) == STEPS
    assert moving.sum() == (motion == 2).sum()
    assert sum(count.static) == (motion == 1).sum() > 0


def test_the_first_world_lacks_what_the_others_have() -> None:
    def classes(world: World) -> set[StreetClass]:
        streets = [draw_street(world, number, seed=3, seconds=2.0) for number in range(6)]
        assert [each.street.weather.rain_share > 0 for each in streets] == [
            each.rain for each in streets
        ]
        return {actor.street_class for each in streets for actor in each.street.actors}

    everything = World(unknown=1.0, rain=1.0, stream=FLEET.stream)
    assert not classes(TAUGHT) & set(UNKNOWN)
    assert set(UNKNOWN) <= classes(everything)


@pytest.mark.timeout(900)
def test_a_small_loop_is_run_and_its_results_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = ["--logs", "2", "--taught", "2", "--held-out", "2", "--steps", "2", "--more-steps", "2"]
    argv = ["bench", "loop", str(tmp_path / "fleet"), *size, "--budgets", "1", "--seed", "1"]
    plot = tmp_path / "loop.png"
    assert main([*argv, "--json", "--plot", str(plot)]) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["fleet_scenes"] == 4
    assert {row["order"] for row in first["rows"]} == {"", *ORDERS}
    assert plot.stat().st_size > 1000
    [kept] = (tmp_path / "fleet" / "loop").iterdir()
    points = sorted((kept / "seed-1").glob("point-*.json"))
    written = {path: path.stat().st_mtime_ns for path in points}
    assert 2 <= len(points) <= 1 + len(ORDERS)

    points[-1].unlink()
    assert main([*argv, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == first
    again = {path: path.stat().st_mtime_ns for path in points}
    assert {path for path in points if again[path] != written[path]} == {points[-1]}


@pytest.mark.parametrize("budgets", ["2,1", "0,1", "1,,2", "x", "1,20000"])
def test_budgets_that_do_not_rise_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], budgets: str
) -> None:
    assert main(["bench", "loop", str(tmp_path), "--budgets", budgets]) != 0
    assert "--budgets" in capsys.readouterr().err
