-- The listing gets the strong tracks of a scene with their ranges, and is filled again from the
-- records.

-- near_ranges, far_ranges: bit n: a strong track more than n and at most n + 1 metres away, bit 0
-- also at 0 metres; the bits of far_ranges follow after 63 metres, its last one is of all beyond.
DROP TABLE listed_scenes;
CREATE TABLE listed_scenes (
    seq {rowid} NOT NULL PRIMARY KEY,
    place DOUBLE PRECISION NOT NULL,
    start_ns BIGINT NOT NULL,
    source BIGINT NOT NULL,
    finding BIGINT NOT NULL,
    judged BIGINT NOT NULL,
    compared BIGINT NOT NULL,
    contradicting BIGINT NOT NULL,
    near_ranges BIGINT NOT NULL,
    far_ranges BIGINT NOT NULL
);
CREATE INDEX listed_by_score
    ON listed_scenes (place, start_ns, seq, source, finding, judged, near_ranges, far_ranges);
CREATE INDEX listed_by_time
    ON listed_scenes (start_ns, seq, place, source, finding, judged, near_ranges, far_ranges);
CREATE INDEX listed_by_verdict ON listed_scenes (judged) WHERE judged > 0;

DROP TABLE listed_words;
CREATE TABLE listed_words (
    seq {rowid} NOT NULL PRIMARY KEY,
    words TEXT NOT NULL
);

-- What strong tracks have in common: a kind, class and attribution, named by a number.
CREATE TABLE listing_things (
    thing BIGINT NOT NULL PRIMARY KEY,
    digest TEXT NOT NULL UNIQUE,
    kind TEXT NOT NULL,
    class_name TEXT NOT NULL,
    wrong TEXT NOT NULL
);

-- Strong tracks of a listed scene, one row for those of one thing, with their ranges as above.
CREATE TABLE listed_tracks (
    thing BIGINT NOT NULL,
    seq BIGINT NOT NULL,
    near_ranges BIGINT NOT NULL,
    far_ranges BIGINT NOT NULL,
    PRIMARY KEY (thing, seq)
) {without_rowid};
CREATE INDEX listed_tracks_of_scene ON listed_tracks (seq);
