-- The first schema. Times in seconds are of the service's clock; *_ns are of the logs.

CREATE TABLE schema_version (
    version BIGINT NOT NULL PRIMARY KEY
);

-- seq: number of the newest scene event; published: how far the outbox is; selection: last number.
CREATE TABLE counters (
    name TEXT NOT NULL PRIMARY KEY,
    value BIGINT NOT NULL
);
INSERT INTO counters (name, value) VALUES ('seq', 0), ('published', 0), ('selection', 0);

-- ordinal: the order in which versions were first seen; the greatest is the newest.
CREATE TABLE pipelines (
    pipeline_version TEXT NOT NULL PRIMARY KEY,
    ordinal BIGINT NOT NULL UNIQUE
);

CREATE TABLE recordings (
    log_id TEXT NOT NULL,
    revision TEXT NOT NULL,
    recording TEXT NOT NULL,
    is_current BOOLEAN NOT NULL,
    PRIMARY KEY (log_id, revision)
);
CREATE UNIQUE INDEX recordings_current ON recordings (log_id) WHERE is_current = {true};

CREATE TABLE plans (
    log_id TEXT NOT NULL,
    revision TEXT NOT NULL,
    pipeline_version TEXT NOT NULL,
    state TEXT NOT NULL,
    attempts BIGINT NOT NULL,
    error TEXT NOT NULL,
    ready_at_s DOUBLE PRECISION NOT NULL,
    lease_id TEXT NOT NULL,
    vehicle TEXT NOT NULL,
    date TEXT NOT NULL,
    software_version TEXT NOT NULL,
    lidar_topics TEXT NOT NULL,
    digest TEXT NOT NULL,
    range_reads BIGINT NOT NULL,
    bytes_read BIGINT NOT NULL,
    PRIMARY KEY (log_id, revision, pipeline_version),
    FOREIGN KEY (log_id, revision) REFERENCES recordings (log_id, revision),
    FOREIGN KEY (pipeline_version) REFERENCES pipelines (pipeline_version)
);
CREATE INDEX plans_state ON plans (pipeline_version, state, log_id);

CREATE TABLE shards (
    log_id TEXT NOT NULL,
    revision TEXT NOT NULL,
    pipeline_version TEXT NOT NULL,
    name TEXT NOT NULL,
    lidar_topic TEXT NOT NULL,
    shard_index BIGINT NOT NULL,
    covers_from_ns BIGINT NOT NULL,
    covers_to_ns BIGINT NOT NULL,
    shard TEXT NOT NULL,
    state TEXT NOT NULL,
    attempts BIGINT NOT NULL,
    error TEXT NOT NULL,
    ready_at_s DOUBLE PRECISION NOT NULL,
    lease_id TEXT NOT NULL,
    digest TEXT NOT NULL,
    committed_s DOUBLE PRECISION NOT NULL,
    frames BIGINT NOT NULL,
    points BIGINT NOT NULL,
    bytes_read BIGINT NOT NULL,
    bytes_needed BIGINT NOT NULL,
    range_reads BIGINT NOT NULL,
    peak_memory_bytes BIGINT NOT NULL,
    stage_s TEXT NOT NULL,
    PRIMARY KEY (log_id, revision, pipeline_version, name),
    FOREIGN KEY (log_id, revision, pipeline_version)
        REFERENCES plans (log_id, revision, pipeline_version)
);
CREATE INDEX shards_state ON shards (pipeline_version, state, log_id, lidar_topic, shard_index);
CREATE INDEX shards_committed ON shards (pipeline_version, committed_s);

-- Every lease ever granted: a late commit must still find what it was for. shard '': to plan.
CREATE TABLE leases (
    lease_id TEXT NOT NULL PRIMARY KEY,
    worker_id TEXT NOT NULL,
    log_id TEXT NOT NULL,
    revision TEXT NOT NULL,
    pipeline_version TEXT NOT NULL,
    shard TEXT NOT NULL,
    expires_s DOUBLE PRECISION NOT NULL,
    is_held BOOLEAN NOT NULL,
    ended_by TEXT NOT NULL
);
CREATE INDEX leases_held ON leases (expires_s) WHERE is_held = {true};

-- What cannot be read. shard '': found by planning.
CREATE TABLE damage (
    log_id TEXT NOT NULL,
    revision TEXT NOT NULL,
    pipeline_version TEXT NOT NULL,
    shard TEXT NOT NULL,
    position BIGINT NOT NULL,
    object_key TEXT NOT NULL,
    byte_offset BIGINT NOT NULL,
    byte_count BIGINT NOT NULL,
    what TEXT NOT NULL,
    PRIMARY KEY (log_id, revision, pipeline_version, shard, position)
);

-- seq NULL: was never current. withdrawn_seq NULL: still current, or replaced under its own key.
CREATE TABLE scenes (
    log_id TEXT NOT NULL,
    revision TEXT NOT NULL,
    pipeline_version TEXT NOT NULL,
    scene_id TEXT NOT NULL,
    shard TEXT NOT NULL,
    seq BIGINT UNIQUE,
    withdrawn_seq BIGINT UNIQUE,
    is_current BOOLEAN NOT NULL,
    withdrawn_by TEXT NOT NULL,
    lidar_topic TEXT NOT NULL,
    vehicle TEXT NOT NULL,
    date TEXT NOT NULL,
    software_version TEXT NOT NULL,
    start_ns BIGINT NOT NULL,
    end_ns BIGINT NOT NULL,
    frames BIGINT NOT NULL,
    state TEXT NOT NULL,
    score DOUBLE PRECISION NOT NULL,
    reasons TEXT NOT NULL,
    both_static BIGINT NOT NULL,
    both_dynamic BIGINT NOT NULL,
    only_semantic_dynamic BIGINT NOT NULL,
    only_predictive_dynamic BIGINT NOT NULL,
    not_compared BIGINT NOT NULL,
    sha256 TEXT NOT NULL,
    record {blob} NOT NULL,
    PRIMARY KEY (log_id, revision, pipeline_version, scene_id),
    FOREIGN KEY (log_id, revision, pipeline_version, shard)
        REFERENCES shards (log_id, revision, pipeline_version, name)
);
CREATE UNIQUE INDEX scenes_current ON scenes (scene_id) WHERE is_current = {true};
CREATE INDEX scenes_current_of_log ON scenes (log_id, start_ns) WHERE is_current = {true};

CREATE TABLE selections (
    name TEXT NOT NULL PRIMARY KEY,
    ordinal BIGINT NOT NULL UNIQUE,
    budget BIGINT NOT NULL,
    created_s DOUBLE PRECISION NOT NULL
);

CREATE TABLE selection_scenes (
    name TEXT NOT NULL,
    position BIGINT NOT NULL,
    scene TEXT NOT NULL,
    PRIMARY KEY (name, position),
    FOREIGN KEY (name) REFERENCES selections (name)
);
