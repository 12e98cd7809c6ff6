-- Overlays that no current scene needs: since when, and whether they have been deleted. Only filled
-- where the setting keep_withdrawn_days asks for it.

CREATE TABLE retired_overlays (
    log_id TEXT NOT NULL,
    scene_id TEXT NOT NULL,
    pipeline_version TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    since_s DOUBLE PRECISION NOT NULL,
    is_deleted BOOLEAN NOT NULL,
    PRIMARY KEY (log_id, scene_id, pipeline_version, sha256)
);
CREATE INDEX retired_overlays_kept ON retired_overlays (since_s) WHERE is_deleted = {false};
-- is_current once more as a column: then SQLite reads no row, and with it no record.
CREATE INDEX scenes_withdrawn ON scenes (log_id, scene_id, pipeline_version, sha256, is_current)
    WHERE is_current = {false};
