-- Which strategy chose a selection; empty: it was stored before strategies had names.
ALTER TABLE selections ADD COLUMN strategy TEXT NOT NULL DEFAULT '';

-- The first entries of the bucket that the last listing skipped since they are no logs. `others`:
-- number of further entries after this one, which are not named.
CREATE TABLE skipped_entries (
    position BIGINT NOT NULL PRIMARY KEY,
    name TEXT NOT NULL,
    why TEXT NOT NULL,
    others BIGINT NOT NULL
);
