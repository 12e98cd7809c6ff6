-- Recordings with the same bytes under several names: the first is mined, the others refer to it.

-- content: digest of the sizes and etags of the parts; empty: unknown. same_as: log that is mined in
-- place of this one.
ALTER TABLE recordings ADD COLUMN content TEXT NOT NULL DEFAULT '';
ALTER TABLE recordings ADD COLUMN same_as TEXT NOT NULL DEFAULT '';
CREATE INDEX recordings_content ON recordings (content) WHERE content <> '';
CREATE INDEX recordings_same ON recordings (same_as) WHERE same_as <> '';

-- Log and revision whose scenes a shard takes over, where they are not its own.
ALTER TABLE shards ADD COLUMN taken_from_log TEXT NOT NULL DEFAULT '';
ALTER TABLE shards ADD COLUMN taken_from_revision TEXT NOT NULL DEFAULT '';
