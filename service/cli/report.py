"""Printed reports: status, ranking, contents of a log, and dry run."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from schemas.score import SceneScore
from service.cli.output import counted, listing, remark, result_line, table
from service.curation.ranking import RankedScene
from service.curation.scene_names import short_names
from service.curation.status import SkippedEntries, Status, skipped_phrases

if TYPE_CHECKING:
    from schemas.work import Damage
    from service.dry_run import DryLog, DryRun


def say_what_was_found(status: Status) -> None:
    """Print the progress of every log, damaged, refused and parked work, and the totals."""
    table(
        "logs",
        ("log", "state", "vehicle", "lidar", "shards", "frames", "reads", "MB read", "damage"),
        (
            (
                log.log_id,
                log.state,
                log.vehicle,
                ", ".join(log.lidar_topics),
                _shards(log.shards),
                log.frames,
                log.plan_range_reads + log.mine_range_reads,
                f"{(log.plan_bytes_read + log.mine_bytes_read) / 1e6:.1f}",
                sum(not damage.is_notice for damage in log.damage) or None,
            )
            for log in status.logs
        ),
    )
    listed_below = {work.log_id for work in (*status.parked, *status.retried) if not work.shard}
    for log in status.logs:
        if log.problem and log.log_id not in listed_below:
            remark(f"{log.state}: {log.log_id}: {log.problem}")
        for damage in log.damage:
            remark(said_of_damage(damage))
    say_skipped(status.skipped)
    for work in status.parked:
        remark(f"parked: {work.log_id} {work.shard} after {work.attempts}: {work.error}")
    if status.parked:
        remark("parked work waits for `counterpoint retry`; fix its cause first")
    for work in status.retried:
        remark(f"tried again: {work.log_id} {work.shard}; before that: {work.error}")
    if status.bytes_needed:
        remark(
            f"mining read {status.bytes_read / 1e6:.1f} MB, "
            f"{status.bytes_read / status.bytes_needed:.3f} of the bytes needed; planning "
            f"{status.plan_bytes_read / 1e6:.1f} MB; "
            f"a worker held at most {status.peak_memory_bytes / 1e6:.0f} MB"
        )
    if status.pipeline_version:
        remark(
            f"logs and frames are those of pipeline version {status.pipeline_version}, the newest; "
            "scenes of an older one stay until it has mined their log"
        )
    if status.judged:
        several = len(status.judged) > 1
        remark(
            "streams: "
            + "; ".join(
                said_of(each.supervised, each.selfsupervised)
                + (f" in {counted(each.scenes, 'scene')}" if several else "")
                for each in status.judged
            )
        )
    points = status.points
    compared = (
        points.both_static
        + points.both_dynamic
        + points.only_semantic_dynamic
        + points.only_predictive_dynamic
    )
    contradicting = points.only_semantic_dynamic + points.only_predictive_dynamic
    remark(
        f"{counted(status.scenes, 'scene')}, {counted(status.frames, 'frame')}; "
        f"{_percent(contradicting, compared)} of {compared:,} compared points contradict "
        f"({_percent(points.only_semantic_dynamic, compared)} "
        "labelled dynamic by the supervised stream alone, "
        f"{_percent(points.only_predictive_dynamic, compared)} by the other alone)"
    )


def said_of_damage(damage: "Damage") -> str:
    """Say what was found in a log: a stretch that cannot be read, or a notice that costs none."""
    if damage.is_notice:
        return f"noticed: {damage.what} ({damage.key})"
    return (
        f"damaged: {damage.what} ({damage.key} at byte {damage.offset}, "
        f"{counted(damage.bytes, 'byte')})"
    )


def said_of(supervised: str, selfsupervised: str) -> str:
    """Name the stream under test, and the stream it was compared with."""
    return f"supervised stream {supervised}, compared with {selfsupervised}"


def say_judged(scores: Iterable[SceneScore]) -> None:
    """Print in one line the streams that these scenes compare."""
    pairs = {(each.producers.supervised, each.producers.selfsupervised): None for each in scores}
    if pairs:
        remark("streams: " + "; ".join(said_of(*pair) for pair in pairs))


def say_reasons(score: SceneScore) -> None:
    """Print the reasons of a scene: the number of the box in the picture, headline, evidence.

    A reason without a number is about the whole scene.
    """
    for reason in score.reasons:
        mark = "-" if reason.track_id is None else str(reason.track_id + 1)
        result_line(f"{mark:<3}{reason.headline}")
        if reason.evidence:
            result_line(f"   {reason.evidence}")


def say_open(scores: Sequence[SceneScore]) -> None:
    """Print what the model under test leaves open over all scenes, one line per cause."""
    points = sum(each.points for each in scores) or 1
    labelled = sum(
        each.points * (each.supervised.labelled_share if each.supervised else 1.0)
        for each in scores
    )
    stated = [each.supervised for each in scores if each.supervised]
    share = f"{labelled / points:.0%} of the returns can contradict"
    reasons = list(dict.fromkeys(each.reason for each in stated if each.reason))
    for reason in reasons:
        remark(f"{reason}; {share}")
    if stated and not reasons:
        remark(share)
    frames = sum(each.frames for each in scores) or 1
    unanswered = sum(
        each.frames * each.supervised.unanswered_share for each in scores if each.supervised
    )
    if unanswered:
        remark(
            f"the model gave no answer in {unanswered / frames:.0%} of the frames: these are not "
            "judged"
        )


def say_ranking(rows: Sequence[RankedScene]) -> None:
    """Print the ranking, best first."""
    say_scenes(counted(len(rows), "scene"), rows, among=rows)


def say_scenes(title: str, rows: Sequence[RankedScene], *, among: Sequence[RankedScene]) -> None:
    """Print scenes, each with its headline below.

    Args:
        title: Printed above.
        rows: Scenes to print.
        among: Scenes among which their short names are unique, and that twins name by rank.
    """
    judged = ("verdicts",) if any(row.verdicts for row in rows) else ()
    rank_of, name_of = {row.scene_id: row.rank for row in among}, short_names(among)
    listing(
        title,
        ("rank", "score", "seconds", "reasons", "twin of", *judged, "scene (begins, UTC)"),
        (
            (
                (
                    row.rank,
                    row.score,
                    f"{(row.end_ns - row.start_ns) / 1e9:.1f}",
                    len(row.reasons) or None,
                    rank_of.get(row.twin_of, row.twin_of) if row.twin_of else None,
                    *((row.verdicts.text if row.verdicts else None,) if judged else ()),
                    name_of.get(row.scene_id, row.scene_id),
                ),
                first_of(row.reasons),
            )
            for row in rows
        ),
    )
    for log_id, names in {row.log_id: row.same_logs for row in rows if row.same_logs}.items():
        remark(f"{log_id}: same bytes as {', '.join(names)}, mined once")


def first_of(reasons: Sequence[str]) -> str:
    """Return the headline of a scene, which is its first reason's; empty without a reason."""
    return reasons[0] if reasons else ""


def say_skipped(skipped: SkippedEntries) -> None:
    """Print the first entries of the bucket that are no logs, and the number of the others."""
    for phrase in skipped_phrases(skipped):
        remark(f"skipped: {phrase}")


def say_inspected(report: dict[str, Any]) -> None:
    """Print the report of `inspect`: facts first, then topics, then unreadable parts."""
    facts = {name: value for name, value in report.items() if name not in ("topics", "damage")}
    facts["shards"] = len(report["shards"])
    start_ns, duration_s = facts.pop("start_ns"), facts.pop("duration_s")
    facts["start (UTC)"] = None if start_ns is None else _utc(start_ns)
    facts["duration"] = None if duration_s is None else _duration(duration_s)
    table(
        str(report["log_id"]),
        ("what", "found"),
        (
            (name.replace("_", " "), ", ".join(value) if isinstance(value, list) else value)
            for name, value in facts.items()
            if name != "log_id"
        ),
    )
    if report["topics"]:
        columns = ["topic", "message_encoding", "schema_name", "messages"]
        if any(topic["needs"] for topic in report["topics"]):
            columns.append("needs")  # what it would take to read a lidar that cannot be read
        table(
            "topics",
            (name.replace("_", " ") for name in columns),
            ((topic[name] for name in columns) for topic in report["topics"]),
        )
    if report["damage"]:
        table("damage", report["damage"][0].keys(), (row.values() for row in report["damage"]))


def say_dry_run(found: "DryRun") -> None:
    """Print the work that a run would do, and the estimate with its basis."""
    table(
        f"logs in {found.bucket}",
        ("log", "parts", "MB", "in the state", "left", "duration", "frames", "problem"),
        (
            (
                log.log_id,
                log.parts,
                f"{log.bytes / 1e6:.1f}",
                _standing(log) if found.pipeline_version else None,
                f"{100 * log.left_share:.0f} %",
                None if log.duration_s is None else _duration(log.duration_s),
                log.frames,
                log.problem,
            )
            for log in found.logs
        ),
    )
    say_skipped(found.skipped)
    left = sum(log.left_share > 0 for log in found.logs)
    if found.not_compared:
        remark(f"not compared with the state, so that all counts as left: {found.not_compared}")
    if found.pipeline_version:
        _say_compared(found)
    remark(
        f"{counted(len(found.logs), 'log')}, {found.bytes / 1e9:.2f} GB; left to mine: "
        f"{counted(left, 'log')}, "
        f"{found.left_bytes / 1e9:.2f} GB, {found.looked_into} indexes read"
        + (", the rest estimated by bytes" if found.looked_into < left else "")
    )
    if not left:
        remark("nothing is left to mine; nothing was mined or written")
        return
    if found.frames is None or found.duration_s is None:
        remark("no estimate: no index could be read; reading needs the extra `workers`")
        return
    what = f"left: about {found.frames} frames in {_duration(found.duration_s)} of recording"
    if found.hours is None or found.seconds_per_frame is None:
        remark(f"{what}; no estimate of the time: {found.pace_from}; mine one log first")
    else:
        remark(
            f"{what}; about {_hours(found.hours)} on {found.workers} workers with a core each, at "
            f"{found.seconds_per_frame:.2f} s per frame ({found.pace_from})"
        )
    remark("nothing was mined or written")


def _say_compared(found: "DryRun") -> None:
    counts = ", ".join(f"{count} {what}" for what, count in sorted(found.by_standing.items()))
    remark(f"under pipeline version {found.pipeline_version} the state has: {counts}")
    if scores := found.by_standing.get("scores"):
        remark(
            f"scores of {counted(scores, 'log')} are computed again from the overlays, tenths of a "
            "second a scene; no frame of them is mined"
        )
    if found.pipeline_version != found.state_version and found.by_standing.get("anew"):
        remark(
            f"the newest pipeline version in the state is another, {found.state_version}: "
            "logs that only that one has mined are mined again"
        )
    if changed := found.by_standing.get("changed"):
        remark(f"of {changed} changed logs, shards in unchanged objects are not mined again")
    if parked := sum(log.parked for log in found.logs):
        remark(f"{parked} plans and shards are parked, and not counted: `counterpoint retry`")


def _standing(log: "DryLog") -> str:
    return f"{log.standing}, {log.parked} parked" if log.parked else log.standing


def _shards(by_state: dict[str, int]) -> str:
    return ", ".join(f"{count} {state}" for state, count in sorted(by_state.items()) if count)


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "-"


def _duration(seconds: float) -> str:
    minutes, rest_s = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {rest_s:02.0f} s" if minutes else f"{rest_s:.1f} s"


def _hours(hours: float) -> str:
    return f"{hours:.1f} hours" if hours >= 1 else f"{max(1, round(hours * 60))} min"


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns / 1e9, tz=UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-5]
