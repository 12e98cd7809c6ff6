-- Revisions that settle, and shards that one revision takes over from another.

-- When the service first listed this revision; 0: before that was noted, long settled.
ALTER TABLE recordings ADD COLUMN listed_s DOUBLE PRECISION NOT NULL DEFAULT 0;

-- The revision that mined this shard, where it is another one: the scenes stay with that; else ''.
ALTER TABLE shards ADD COLUMN adopted_from TEXT NOT NULL DEFAULT '';

-- Rates are asked for a time of recording: a dashboard of the last days reads only those.
CREATE INDEX scenes_current_recorded ON scenes (start_ns) WHERE is_current = {true};
