-- Layers of pipeline versions, scores computed again, and the order in which a fleet is mined again.

-- Digests of the layers; empty: a version of an earlier program.
ALTER TABLE pipelines ADD COLUMN labels TEXT NOT NULL DEFAULT '';
ALTER TABLE pipelines ADD COLUMN contradictions TEXT NOT NULL DEFAULT '';
ALTER TABLE pipelines ADD COLUMN score TEXT NOT NULL DEFAULT '';

-- turn: place in the order of claims, lower first. inherited_from: version whose plan was copied.
ALTER TABLE plans ADD COLUMN turn BIGINT NOT NULL DEFAULT 0;
ALTER TABLE plans ADD COLUMN inherited_from TEXT NOT NULL DEFAULT '';

-- rescored_from: version of whose scenes the scores are computed again; empty: the log is mined.
-- mined_s: seconds of a core that mining took.
ALTER TABLE shards ADD COLUMN turn BIGINT NOT NULL DEFAULT 0;
ALTER TABLE shards ADD COLUMN rescored_from TEXT NOT NULL DEFAULT '';
ALTER TABLE shards ADD COLUMN mined_s DOUBLE PRECISION NOT NULL DEFAULT 0;

DROP INDEX plans_state;
CREATE INDEX plans_state ON plans (pipeline_version, state, turn, log_id);
DROP INDEX shards_state;
CREATE INDEX shards_state
    ON shards (pipeline_version, state, turn, log_id, lidar_topic, shard_index);
