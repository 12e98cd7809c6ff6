-- Verdicts of reviewers: events, never changed but for is_current. `vehicle`, `software_version` and
-- `kinds` (of the strong tracks, as in listing_findings) are copied from the judged record.
CREATE TABLE verdicts (
    ordinal BIGINT NOT NULL PRIMARY KEY,
    key TEXT NOT NULL UNIQUE,
    scene_id TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    track_id BIGINT,
    reviewer TEXT NOT NULL,
    verdict TEXT NOT NULL,
    cause TEXT NOT NULL,
    note TEXT NOT NULL,
    duplicate_of TEXT,
    judged_s DOUBLE PRECISION NOT NULL,
    took_s DOUBLE PRECISION,
    is_current BOOLEAN NOT NULL,
    vehicle TEXT NOT NULL,
    software_version TEXT NOT NULL,
    kinds TEXT NOT NULL
);
CREATE INDEX verdicts_of_scene ON verdicts (scene_id, ordinal);
CREATE INDEX verdicts_of_reviewer ON verdicts (reviewer, ordinal) WHERE is_current = {true};

-- Number of the last verdict, and of the last one that is published.
INSERT INTO counters (name, value) VALUES ('verdict', 0);
INSERT INTO counters (name, value) VALUES ('verdict_published', 0);

-- The listing: what current scenes are filtered and sorted by, in rows of numbers, since a scan of
-- the scenes would read every record. Sources and findings repeat, and are named by a number.
CREATE TABLE listing_sources (
    source BIGINT NOT NULL PRIMARY KEY,
    digest TEXT NOT NULL UNIQUE,
    log_id TEXT NOT NULL,
    lidar_topic TEXT NOT NULL,
    vehicle TEXT NOT NULL,
    software_version TEXT NOT NULL,
    mode TEXT NOT NULL
);

-- Of the strong tracks of a scene: their kinds, classes and attributions, each set as `|a|b|`.
CREATE TABLE listing_findings (
    finding BIGINT NOT NULL PRIMARY KEY,
    digest TEXT NOT NULL UNIQUE,
    kinds TEXT NOT NULL,
    class_names TEXT NOT NULL,
    wrongs TEXT NOT NULL
);

-- place: the score times -1, so that the best is first; 1 without a valid score. judged: number of
-- the last verdict on the record that counts, 0 without one.
CREATE TABLE listed_scenes (
    seq {rowid} NOT NULL PRIMARY KEY,
    place DOUBLE PRECISION NOT NULL,
    start_ns BIGINT NOT NULL,
    source BIGINT NOT NULL,
    finding BIGINT NOT NULL,
    judged BIGINT NOT NULL,
    compared BIGINT NOT NULL,
    contradicting BIGINT NOT NULL
);
-- Each index has every filter in it, so that no row is read while one is walked.
CREATE INDEX listed_by_score ON listed_scenes (place, start_ns, seq, source, finding, judged);
CREATE INDEX listed_by_time ON listed_scenes (start_ns, seq, place, source, finding, judged);
CREATE INDEX listed_by_verdict ON listed_scenes (judged) WHERE judged > 0;

-- What a search looks in: the scene's id and headlines, in lower case.
CREATE TABLE listed_words (
    seq {rowid} NOT NULL PRIMARY KEY,
    words TEXT NOT NULL
);
