-- Logs that were mined only as far as they go, countable at every scrape.

-- Objects of the recording that were never closed by their writer.
ALTER TABLE plans ADD COLUMN truncated_parts BIGINT NOT NULL DEFAULT 0;
UPDATE plans SET truncated_parts = (
    SELECT count(DISTINCT damage.object_key) FROM damage
    WHERE damage.log_id = plans.log_id
        AND damage.revision = plans.revision
        AND damage.pipeline_version = plans.pipeline_version
        AND damage.shard = ''
        AND damage.what = 'the file was never closed: it has no end mark'
);
CREATE INDEX plans_truncated ON plans (pipeline_version) WHERE truncated_parts > 0;
CREATE INDEX damage_of_pipeline ON damage (pipeline_version, log_id, revision);
