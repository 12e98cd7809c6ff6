"""Output of `top --learned`: the ranking, its source, and its effect on unseen verdicts."""

from schemas.errors import PermanentError
from service.api.messages import TopReply
from service.cli.output import json_line, remark
from service.cli.report import say_ranking
from service.curation.learned_effect import LearnedEffect, WithAndWithout


def say_learned(reply: TopReply, *, json: bool) -> None:
    """Print a learned ranking and its effect; as JSON first the effect, then a line for each row.

    Raises:
        PermanentError: If the service answered without an effect.
    """
    found = reply.learned
    if found is None:
        raise PermanentError("the service ranked by the score alone: it did not learn")
    if json:
        json_line({"effect": found.effect.model_dump(mode="json")})
        for row, chance in zip(reply.scenes, found.chances, strict=True):
            json_line(row.model_dump(mode="json") | {"learned": round(chance, 4)})
    else:
        say_ranking(reply.scenes)
    for line in effect_lines(found.effect):
        remark(line)


def effect_lines(effect: LearnedEffect) -> list[str]:
    """Return what a ranking learned from, its effect on unseen verdicts, and which one is shown."""
    shown = (
        "ranked by what they teach"
        if effect.is_used
        else "no gain on verdicts that were not seen: ranked by the score"
    )
    calibration = ", ".join(
        f"{row.predicted:.2f} predicted {row.right:.2f} right of {row.scenes}"
        for row in effect.reliability
    )
    return [
        f"learned from {effect.verdicts} judged scenes of {effect.logs} logs, "
        f"{effect.right} right; {shown}",
        "on verdicts of logs that were not seen, by the score and learned: "
        f"average precision {_pair(effect.average_precision)}; "
        f"precision of the first {effect.first} {_pair(effect.precision)}; "
        f"Brier score {_pair(effect.brier)}",
        f"calibration: {calibration}",
    ]


def _pair(figure: WithAndWithout) -> str:
    if figure.score is None or figure.learned is None:
        return "undefined, since none is right"
    pair = f"{figure.score:.3f} and {figure.learned:.3f}"
    if figure.low is None or figure.high is None:
        return pair
    return f"{pair} (difference {figure.low:+.3f} to {figure.high:+.3f})"
