-- Audit log: who selected, judged, retried and exported what, and when. `digest` is over the row and
-- the digest of the one before it.
CREATE TABLE audit (
    ordinal BIGINT NOT NULL PRIMARY KEY,
    at_s DOUBLE PRECISION NOT NULL,
    name TEXT NOT NULL,
    says TEXT NOT NULL,
    via TEXT NOT NULL,
    what TEXT NOT NULL,
    detail TEXT NOT NULL,
    digest TEXT NOT NULL
);

-- Number of the last row.
INSERT INTO counters (name, value) VALUES ('audit', 0);
