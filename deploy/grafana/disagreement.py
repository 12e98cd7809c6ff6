"""Dashboard for perception engineers: where and when the two streams disagree."""

from typing import Final

from deploy.grafana.panels import RED, YELLOW, Ask, Dashboard, Panel, Query, Row

ONLY: Final = 'agreement=~"only_.+"'
COMPARED: Final = 'agreement!="not_compared"'
IN_RANGE: Final = "[$__range]"
AT_A_TIME: Final = "[$__rate_interval]"


def rate(only: str, compared: str, *, of: str = "counterpoint_points_total", by: str = "") -> str:
    """Return the query for the share of compared points that contradict.

    Without mined points it is 0 / 0, which has no value.
    """
    grouped = f"sum{f' by ({by})' if by else ''}"
    return f"{grouped} (rate({of}{only})) / {grouped} (rate({of}{compared}))"


AGREEMENT_COLOURS: Final = {
    "both_static": "#8a8f98",
    "both_dynamic": "#56a64b",
    "only_semantic_dynamic": "#3274d9",
    "only_predictive_dynamic": "#e0752d",
    "not_compared": "#3a3d42",
}
"""Colour of each agreement, in every panel."""

CONTRADICTIONS: Final = {
    name: AGREEMENT_COLOURS[name] for name in ("only_semantic_dynamic", "only_predictive_dynamic")
}

NOW: Final = Row(
    "In this time range",
    (
        Panel(
            title="Disagreement rate",
            description="Compared points on which exactly one stream says dynamic, over all "
            "compared points stored in this time range. What matters is your own past: see it "
            "over time.",
            unit="percentunit",
            kind="stat",
            width=4,
            height=5,
            decimals=2,
            queries=(
                Query(rate(f"{{{ONLY}}}{IN_RANGE}", f"{{{COMPARED}}}{IN_RANGE}"), "disagreement"),
            ),
        ),
        Panel(
            title="Scenes stored",
            description="Scenes whose score is on disk, each counted once, in this time range.",
            unit="short",
            kind="stat",
            width=4,
            height=5,
            decimals=0,
            queries=(Query(f"sum (increase(counterpoint_scenes_total{IN_RANGE}))", "scenes"),),
        ),
        Panel(
            title="Contradicting tracks per scene",
            description="Things on which the streams contradict each other, per stored scene.",
            unit="short",
            kind="stat",
            width=4,
            height=5,
            decimals=1,
            queries=(
                Query(
                    f"sum (rate(counterpoint_contradicting_tracks_total{IN_RANGE}))"
                    f" / sum (rate(counterpoint_scenes_total{IN_RANGE}))",
                    "tracks per scene",
                ),
            ),
        ),
        Panel(
            title="Scenes with a score of 0.5 or more",
            description="Share of the scenes stored in this time range that hold a strong "
            "contradiction. Close to 1 means that a fault of a stream floods the ranking.",
            unit="percentunit",
            kind="stat",
            width=4,
            height=5,
            thresholds=((0.5, YELLOW), (0.9, RED)),
            queries=(
                Query(
                    f'1 - sum (rate(counterpoint_scene_score_bucket{{le="0.5"}}{IN_RANGE}))'
                    f" / sum (rate(counterpoint_scene_score_count{IN_RANGE}))",
                    "share",
                ),
            ),
        ),
        Panel(
            title="Points compared",
            description="Share of all points on which both streams had an answer. Far, unseen and "
            "first points of a log are not compared; a fall means that a stream lost its footing.",
            unit="percentunit",
            kind="stat",
            width=4,
            height=5,
            queries=(
                Query(
                    f"sum (rate(counterpoint_points_total{{{COMPARED}}}{IN_RANGE}))"
                    f" / sum (rate(counterpoint_points_total{IN_RANGE}))",
                    "compared",
                ),
            ),
        ),
        Panel(
            title="Scenes without a trusted pose",
            description="Share of the stored scenes whose odometry was lost. They rank last, "
            "unseen.",
            unit="percentunit",
            kind="stat",
            width=4,
            height=5,
            thresholds=((0.02, YELLOW), (0.1, RED)),
            queries=(
                Query(
                    f'sum (rate(counterpoint_scenes_total{{state="odometry_lost"}}{IN_RANGE}))'
                    f" / sum (rate(counterpoint_scenes_total{IN_RANGE}))",
                    "odometry lost",
                ),
            ),
        ),
    ),
)

OVER_TIME: Final = Row(
    "Over time",
    (
        Panel(
            title="Disagreement rate by kind",
            description="Share of the compared points that only one stream calls dynamic. Blue: "
            "only the supervised stream; orange: only the self-supervised one. When one rises "
            "alone, that stream, or what it depends on, has changed.",
            unit="percentunit",
            width=12,
            stacked=True,
            colours=CONTRADICTIONS,
            queries=(
                Query(
                    f"sum by (agreement) (rate(counterpoint_points_total{{{ONLY}}}{AT_A_TIME}))"
                    f" / ignoring (agreement) group_left ()"
                    f" sum (rate(counterpoint_points_total{{{COMPARED}}}{AT_A_TIME}))",
                    "{{agreement}}",
                ),
            ),
        ),
        Panel(
            title="Points by agreement",
            description="Every point of the stored scenes by what the two streams say of it, per "
            "second of running.",
            unit="short",
            width=12,
            stacked=True,
            colours=AGREEMENT_COLOURS,
            queries=(
                Query(
                    f"sum by (agreement) (rate(counterpoint_points_total{AT_A_TIME}))",
                    "{{agreement}}",
                ),
            ),
        ),
        Panel(
            title="Disagreement rate by vehicle",
            description="Vehicles named in the setting `vehicles`; all others are `other`. One "
            "that leaves the others behind has a sensor or a calibration to look at.",
            unit="percentunit",
            width=12,
            queries=(
                Query(
                    rate(
                        f'{{{ONLY}, vehicle=~"$vehicle"}}{AT_A_TIME}',
                        f'{{{COMPARED}, vehicle=~"$vehicle"}}{AT_A_TIME}',
                        of="counterpoint_vehicle_points_total",
                        by="vehicle",
                    ),
                    "{{vehicle}}",
                ),
            ),
        ),
        Panel(
            title="Scenes per hour by vehicle",
            description="Speed at which scenes are stored. A vehicle that falls silent sends no "
            "logs, or they are refused.",
            unit="short",
            width=12,
            stacked=True,
            queries=(
                Query(
                    "sum by (vehicle) (rate(counterpoint_vehicle_scenes_total"
                    f'{{vehicle=~"$vehicle"}}{AT_A_TIME})) * 3600',
                    "{{vehicle}}",
                ),
            ),
        ),
    ),
)

SCENES: Final = Row(
    "Scenes and their scores",
    (
        Panel(
            title="Scores over time",
            description="How many scenes were stored with which score. A band that moves upwards "
            "at once, for every vehicle, is a fault of a stream rather than of the street.",
            unit="short",
            kind="heatmap",
            width=12,
            queries=(
                Query(
                    f"sum by (le) (increase(counterpoint_scene_score_bucket{AT_A_TIME}))", "{{le}}"
                ),
            ),
        ),
        Panel(
            title="Scenes per hour by state",
            description="Scenes by usability of their score. Only `scored` ones are ranked by "
            "their contradictions.",
            unit="short",
            width=12,
            stacked=True,
            queries=(
                Query(
                    f"sum by (state) (rate(counterpoint_scenes_total{AT_A_TIME})) * 3600",
                    "{{state}}",
                ),
            ),
        ),
        Panel(
            title="Contradicting tracks per scene by kind",
            description="Objects tracked over a scene that only one stream labels dynamic.",
            unit="short",
            width=12,
            stacked=True,
            colours=CONTRADICTIONS,
            queries=(
                Query(
                    f"sum by (kind) (rate(counterpoint_contradicting_tracks_total{AT_A_TIME}))"
                    f" / ignoring (kind) group_left ()"
                    f" sum (rate(counterpoint_scenes_total{AT_A_TIME}))",
                    "{{kind}}",
                ),
            ),
        ),
        Panel(
            title="Contradicting instances per track",
            description="Mean number of frames with a contradicting object. A fall means "
            "flicker: contradictions that last for a frame or two.",
            unit="short",
            width=12,
            colours=CONTRADICTIONS,
            queries=(
                Query(
                    f"sum by (kind) (rate(counterpoint_contradicting_instances_total{AT_A_TIME}))"
                    f" / sum by (kind) (rate(counterpoint_contradicting_tracks_total{AT_A_TIME}))",
                    "{{kind}}",
                ),
            ),
        ),
    ),
)

RATES_BY_KIND: Final = ("only_semantic_dynamic_rate", "only_predictive_dynamic_rate")

STORE: Final = Row(
    "From the store: scenes by what they were recorded with, and when",
    tuple(
        Panel(
            title=title,
            description=f"{what} Share of the compared points of current scenes that were recorded "
            "in the time chosen above as `recorded`. Asked of the service: it reaches back further "
            "than Prometheus, and knows every vehicle, version and log.",
            unit="percentunit",
            kind="barchart",
            width=width,
            stacked=True,
            colours={f"{name}_rate": colour for name, colour in CONTRADICTIONS.items()},
            ask=Ask(by, values, most),
        )
        for by, title, width, values, most, what in (
            (
                "version",
                "Disagreement rate by software version",
                8,
                RATES_BY_KIND,
                20,
                "A release that disagrees more than the one before.",
            ),
            (
                "vehicle",
                "Disagreement rate of every vehicle",
                8,
                RATES_BY_KIND,
                40,
                "A car that disagrees more than the others: its sensor, or its calibration.",
            ),
            (
                "kind",
                "Disagreement rate by kind, all scenes",
                8,
                ("disagreement_rate",),
                2,
                "Share of points that one stream alone labels dynamic.",
            ),
            (
                "hour",
                "Disagreement rate by hour of recording",
                12,
                RATES_BY_KIND,
                200,
                "Rain, night, a rush hour.",
            ),
            (
                "log",
                "Disagreement rate by log, the worst first",
                12,
                RATES_BY_KIND,
                25,
                "The drives to look at first.",
            ),
        )
    ),
)

REVIEW: Final = Row(
    "Review",
    (
        Panel(
            title="Verdicts per hour",
            description="Verdicts of reviewers by value; `withdrawn` is an undo. When `unsure` or "
            "`duplicate` takes over, the pictures or the choice of scenes do not help.",
            unit="short",
            width=12,
            stacked=True,
            queries=(
                Query(
                    f"sum by (verdict) (rate(counterpoint_verdicts_total{AT_A_TIME})) * 3600",
                    "{{verdict}}",
                ),
            ),
        ),
        Panel(
            title="Precision so far",
            description="Share of the judged scenes on which the supervised stream is wrong. When "
            "it falls, reviewers look at scenes in vain.",
            unit="percentunit",
            width=12,
            most=1,
            queries=(
                Query(
                    'sum (counterpoint_judged_scenes{outcome="right"})'
                    " / sum (counterpoint_judged_scenes)",
                    "precision",
                ),
            ),
        ),
        Panel(
            title="Comparisons of versions",
            description="Answered comparisons of two versions by result. `regressed`: a kind, "
            "class or mode of tracks occurs significantly more often in version B.",
            unit="short",
            width=12,
            stacked=True,
            queries=(
                Query(
                    "sum by (result) (increase(counterpoint_comparisons_total[1d]))", "{{result}}"
                ),
            ),
        ),
    ),
)

DASHBOARD: Final = Dashboard(
    uid="counterpoint-disagreement",
    title="Counterpoint: disagreement",
    description="Where and when the supervised and the self-supervised stream contradict each "
    "other.",
    since="now-24h",
    rows=(NOW, OVER_TIME, SCENES, REVIEW, STORE),
    variables={"vehicle": "label_values(counterpoint_vehicle_scenes_total, vehicle)"},
    choices={
        "recorded": (
            ("at any time", "1970-01-01"),
            ("in the last day", "24h"),
            ("in the last week", "7d"),
            ("in the last four weeks", "4w"),
        )
    },
)
