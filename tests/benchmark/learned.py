"""Precision of the next scenes after 30 verdicts, by the score and by what the verdicts teach.

A scene is right where a planted failure happens in it, or is shown by a mined log. Logs are drawn
at random until 30 scenes are judged; the best of the others are then looked at. Several states are
one fleet; a street that occurs in two of them is drawn in both. With `--class` only failures on
this class are right, as in a house that looks for nothing else. Run it with

    python -m tests.benchmark.learned STATE FLEET [STATE FLEET …] [--class pedestrian]
    python -m tests.benchmark.learned --kept FOLDER       # of `counterpoint bench failures --kept`
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from schemas.events import RankedScene
from schemas.verdict import Verdict, VerdictRow
from service.api.state_reader import StateReader
from service.cli.output import result_line
from service.curation.learned import MIN_VERDICTS, learned_ranking
from service.evaluation.mined_fleet import fleet_of, read_logs
from service.settings.config import read_settings
from workers.lab.simulation.faults.fault_truth import PlantedTruth

_NEXT: Final = 30
"""Scenes looked at after the verdicts; half of the others where these are fewer than 60."""

Fleet = list[tuple[RankedScene, bool, str]]
"""Scenes by the score, whether the supervised stream is wrong, and the street."""


def of_states(pairs: list[Path], *, only: str = "") -> Fleet:
    """Read states and the truth of their fleets; `only` is the one class that counts."""
    found: Fleet = []
    for number, (state, folder) in enumerate(zip(pairs[::2], pairs[1::2], strict=True)):
        truths: dict[str, PlantedTruth | None] = {}
        for scene in StateReader(read_settings(state=state).settings, now_s=0.0).top():
            log_id = scene.log_id
            if log_id not in truths:
                at = folder / "truth" / log_id.removeprefix("logs/").removesuffix(".mcap")
                truths[log_id] = PlantedTruth.beside(at)
            truth = truths[log_id]
            if truth is None:
                raise SystemExit(f"no planted failures are known of {log_id} below {folder}/truth")
            is_right = any(
                each.start_ns <= scene.end_ns
                and scene.start_ns < each.end_ns
                and only in ("", each.class_name)
                for each in truth.failures
            )
            named = {"scene_id": f"{number}/{scene.scene_id}", "log_id": f"{number}/{log_id}"}
            found.append((scene.model_copy(update=named), is_right, log_id))
    return ordered(found)


def of_kept(folder: Path, *, only: str = "") -> Fleet:
    """Read mined logs of a benchmark; `only` is the one class that counts."""
    scenes = fleet_of(read_logs(folder))
    found: Fleet = []
    for number, each in enumerate(scenes):
        scene = each.candidate.scene
        is_right = any(only in ("", failing.class_name) for failing in each.row.failing)
        unique = scene.model_copy(update={"scene_id": f"{number}/{scene.scene_id}"})
        found.append((unique, is_right, scene.log_id))
    return ordered(found)


def ordered(fleet: Fleet) -> Fleet:
    """Order a fleet by the score."""
    return sorted(fleet, key=lambda each: (-each[0].score, each[0].scene_id))


def draws(fleet: Fleet, *, number: int, seed: int) -> Iterator[tuple[float, float, float, bool]]:
    """Yield the precision of the next scenes by the score, with `--learned`, at best; its use."""
    rng = np.random.default_rng(seed)
    streets = sorted({street for _, _, street in fleet})
    scenes = [scene for scene, _, _ in fleet]
    truth = {scene.scene_id: is_right for scene, is_right, _ in fleet}
    for _ in range(number):
        judged: list[RankedScene] = []
        for street in rng.permutation(streets).tolist():
            if len(judged) >= MIN_VERDICTS:
                break
            judged += [scene for scene, _, at in fleet if at == street]
        taken = {scene.scene_id for scene in judged}
        verdicts = [
            _verdict(at, scene, is_right=truth[scene.scene_id]) for at, scene in enumerate(judged)
        ]
        ranked, _, effect = learned_ranking(scenes, verdicts)
        most = min(_NEXT, (len(scenes) - len(taken)) // 2)
        before, after = (
            [truth[each.scene_id] for each in order if each.scene_id not in taken][:most]
            for order in (scenes, ranked)
        )
        right = sum(truth[each.scene_id] for each in scenes if each.scene_id not in taken)
        best = min(1.0, right / most)
        yield float(np.mean(before)), float(np.mean(after)), best, effect.is_used


def _verdict(number: int, scene: RankedScene, *, is_right: bool) -> VerdictRow:
    return VerdictRow(
        ordinal=number,
        key=f"planted-{number}",
        scene_id=scene.scene_id,
        sha256=scene.sha256,
        reviewer="truth",
        verdict=Verdict.SUPERVISED if is_right else Verdict.NEITHER,
        judged_s=0.0,
        is_current=True,
        record="current",
    )


def main() -> int:
    """Print one line about a fleet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pairs", nargs="*", type=Path, metavar="STATE FLEET")
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--class", dest="only", default="")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=20261503)
    asked = parser.parse_args()
    if len(asked.pairs) % 2 or bool(asked.pairs) == bool(asked.kept):
        parser.error("give each STATE with its FLEET, or --kept FOLDER")
    fleet = (
        of_kept(asked.kept, only=asked.only)
        if asked.kept
        else of_states(asked.pairs, only=asked.only)
    )
    found = np.array(list(draws(fleet, number=asked.draws, seed=asked.seed)))
    before, after, best, used = found.T
    low, high = np.percentile(after - before, (2.5, 97.5))
    right = sum(is_right for _, is_right, _ in fleet)
    result_line(
        f"{len(fleet)} scenes, {right} right: precision {before.mean():.3f} by the score, "
        f"{after.mean():.3f} with --learned, {best.mean():.3f} at best, "
        f"difference {(after - before).mean():+.3f} "
        f"({low:+.3f} to {high:+.3f}), better in {(after > before).mean():.0%} of {len(found)} "
        f"draws, worse in {(after < before).mean():.0%}, used in {used.mean():.0%}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
