-- How far each receiver of webhooks has each source of events: scenes by `seq`, selections by
-- ordinal, notices by theirs. `receiver` is a digest of its URL.
CREATE TABLE webhook_cursors (
    receiver TEXT NOT NULL,
    source TEXT NOT NULL,
    value BIGINT NOT NULL,
    PRIMARY KEY (receiver, source)
);

-- Events that have no number elsewhere, such as a failure mode that was not there before. Each kind
-- and name is noted once; `body` is JSON.
CREATE TABLE notices (
    ordinal BIGINT NOT NULL PRIMARY KEY,
    kind TEXT NOT NULL,
    name TEXT NOT NULL,
    body TEXT NOT NULL,
    noted_s DOUBLE PRECISION NOT NULL,
    UNIQUE (kind, name)
);
