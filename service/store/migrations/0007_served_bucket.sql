-- The log bucket whose logs these are: at most one row, written by the first run that names it.

CREATE TABLE served_bucket (
    url TEXT NOT NULL
);
