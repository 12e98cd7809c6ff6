-- The ranking is read in its order, as far as it is asked for.
CREATE INDEX scenes_ranked
    ON scenes ((state <> 'scored'), score DESC, log_id {bytewise}, start_ns, scene_id)
    WHERE is_current = {true};
