-- Lane of a lease: the place of its log in the order of priorities; 63: without one.
ALTER TABLE leases ADD COLUMN lane BIGINT NOT NULL DEFAULT 63;
