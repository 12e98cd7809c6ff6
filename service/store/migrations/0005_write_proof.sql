-- One row that is written for no other reason than to see whether anything can be.

CREATE TABLE write_proof (
    writes BIGINT NOT NULL
);
INSERT INTO write_proof (writes) VALUES (0);
