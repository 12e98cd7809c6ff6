-- Which database this is: a random id, given at its first opening. `writes` counts every transaction
-- that changes something, so that an older copy under a running service is noticed.

ALTER TABLE write_proof ADD COLUMN incarnation TEXT NOT NULL DEFAULT '';
