-- Who serves this database: every opening for writing raises `term`, and a transaction under an
-- earlier term is refused. `beats` grows while the service of the newest term lives, which a standby
-- watches; `lease_s` is how long its silence may last.
ALTER TABLE write_proof ADD COLUMN term BIGINT NOT NULL DEFAULT 0;

CREATE TABLE service_lease (
    beats BIGINT NOT NULL,
    lease_s DOUBLE PRECISION NOT NULL
);
INSERT INTO service_lease (beats, lease_s) VALUES (0, 0);
