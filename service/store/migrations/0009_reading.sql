-- Which strategy chose a selection; empty: it was stored before strategies had names.
ALTER TABLE selections ADD COLUMN strategy TEXT NOT NULL DEFAULT '';

-- Entries of the bucket that the last listing skipped since they are no logs: the first by name, and
-- how many in all.
CREATE TABLE skipped_entries (
    position BIGINT NOT NULL PRIMARY KEY,
    name TEXT NOT NULL,
    why TEXT NOT NULL
);
INSERT INTO counters (name, value) VALUES ('skipped', 0);
