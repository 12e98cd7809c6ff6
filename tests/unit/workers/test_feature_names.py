"""Names of the features in records of version 1 and 2, and weights that kept their values."""

import hashlib
import json
from importlib import resources

from schemas.canonical import canonical_json
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

ADDED = ("blind_share", "witness_votes", "bulk_motion")
"""Features that version 1 did not have; their weights are those of the prior."""

WEIGHTS_OF_VERSION_1 = "e4d4534a87bc1b91977d4d479ef1047ecb17233fd48a32a80810754f57e4c023"
"""Digest of the table of version 1, with the names of version 1."""


def test_every_feature_has_one_name_of_each_version_in_the_same_order() -> None:
    assert (*VERSION_2_OF.values(), *ADDED) == NAMES
    assert len(set(VERSION_2_OF)) == len(NAMES) - len(ADDED)


def test_the_table_of_attribution_kept_every_weight() -> None:
    version_1_of = {new: old for old, new in VERSION_2_OF.items()}
    text = resources.files("workers.contradiction").joinpath("attribution.json").read_text()
    kinds = json.loads(text)["kinds"]
    for rows in kinds.values():
        for row in rows.values():
            row["weights"] = {
                version_1_of[name]: each
                for name, each in row["weights"].items()
                if name not in ADDED
            }
    assert hashlib.sha256(canonical_json(kinds)).hexdigest() == WEIGHTS_OF_VERSION_1
