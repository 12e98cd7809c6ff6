"""Names of the features in records of version 1 and 2."""

from workers.contradiction.track_features import NAMES

VERSION_2_OF = {
    "witness_moving": "witness_dynamic",
    "witness_still": "witness_static",
    "went": "displacement",
    "straight": "straightness",
    "lasting": "duration",
    "steady": "continuity",
    "many_points": "point_count",
    "far": "distance",
    "road_user": "road_user_size",
    "long": "length",
    "tall": "height",
    "thin": "thinness",
    "low": "lowness",
    "agreed_before": "agreed_before",
    "undenied_after": "not_refuted_after",
    "called_before": "dynamic_before",
    "called_after": "dynamic_after",
    "stays": "shape_static",
    "stands_after": "shape_static_after",
    "came": "arrived",
    "leaves": "departed",
    "passes": "transits",
    "log_ends": "log_end",
    "own": "isolation",
    "supervised_sure": "supervised_confidence",
    "selfsupervised_sure": "selfsupervised_confidence",
    "confirmed": "confirmed",
    "speed_fits": "speed_consistency",
    "fast": "speed",
    "doubted": "pose_doubted",
    "turning": "turn_rate",
    "unseen": "unobserved",
    "denied": "denied_share",
    "agreed": "agreed_share",
    "silent": "unlabelled_share",
    "crowded": "clutter",
    "ground_rises": "rising_ground",
}
"""Name of each feature in version 1, to its name in version 2; in the order of both."""

ADDED = ("blind_share", "witness_votes", "bulk_motion", "label_time")
"""Features that version 1 did not have."""


def test_every_feature_has_one_name_of_each_version_in_the_same_order() -> None:
    assert (*VERSION_2_OF.values(), *ADDED) == NAMES
    assert len(set(VERSION_2_OF)) == len(NAMES) - len(ADDED)
