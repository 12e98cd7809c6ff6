"""Dashboard for operators: liveness, throughput, errors."""

from typing import Final

from deploy.grafana.panels import RED, YELLOW, Dashboard, Panel, Query, Row

AT_A_TIME: Final = "[$__rate_interval]"


def per_second(metric: str, by: str = "") -> str:
    """Return the query for the rate of a counter over all instances, per second."""
    return f"sum{f' by ({by})' if by else ''} (rate({metric}{AT_A_TIME}))"


def quantile(share: float, histogram: str) -> str:
    """Return the query for a quantile of a histogram over all instances."""
    return f"histogram_quantile({share}, sum by (le) (rate({histogram}_bucket{AT_A_TIME})))"


def _stat(
    title: str,
    description: str,
    expr: str,
    *,
    unit: str = "short",
    decimals: int | None = None,
    thresholds: tuple[tuple[float, str], ...] = (),
) -> Panel:
    return Panel(
        title=title,
        description=description,
        unit=unit,
        kind="stat",
        width=3,
        height=4,
        decimals=decimals,
        thresholds=thresholds,
        queries=(Query(expr, title.lower()),),
    )


NOW: Final = Row(
    "Now",
    (
        _stat(
            "Answering",
            "Share of the processes of Counterpoint that answered the last scrape.",
            'avg (up{job=~"counterpoint.*"})',
            unit="percentunit",
        ),
        _stat(
            "Since the last listing",
            "Age of what is known of the bucket. It is listed every 10 s unless set otherwise.",
            "time() - min (counterpoint_bucket_last_listing_timestamp_seconds)",
            unit="s",
            decimals=0,
            thresholds=((60, YELLOW), (300, RED)),
        ),
        _stat(
            "Oldest work",
            "Since the oldest recording with work left was first listed; 0: nothing is left to do.",
            "max (counterpoint_oldest_work_age_seconds)",
            unit="s",
            decimals=0,
            thresholds=((6 * 3600, YELLOW), (24 * 3600, RED)),
        ),
        _stat(
            "Shards waiting",
            "Shards that a worker could take now. About 16 are planned ahead of the workers.",
            'sum (counterpoint_work{work="shard", state="ready"})',
        ),
        _stat(
            "Parked",
            "Plans and shards that are not tried again. `counterpoint status` names each.",
            'sum (counterpoint_work{state="parked"})',
            thresholds=((1, RED),),
        ),
        _stat(
            "Worker processes missing",
            "Wanted, but not running now.",
            "sum (counterpoint_worker_processes_wanted)"
            " - sum (counterpoint_worker_processes_alive)",
            thresholds=((1, YELLOW),),
        ),
        _stat(
            "Current scenes",
            "Scenes in the ranking.",
            "sum (counterpoint_current_scenes)",
        ),
        _stat(
            "Free for the state",
            "Free bytes of the disk with the state folder. When it is full, no commit is taken.",
            "min (counterpoint_state_free_bytes)",
            unit="bytes",
        ),
    ),
)

PROGRESS: Final = Row(
    "Progress",
    (
        Panel(
            title="Frames per second",
            description="Lidar frames whose scenes are stored, each once, and frames mined by the "
            "workers, attempts included: a gap between the two is work done twice.",
            unit="short",
            queries=(
                Query(per_second("counterpoint_frames_total"), "stored"),
                Query(per_second("counterpoint_worker_frames_total"), "mined"),
            ),
        ),
        Panel(
            title="Scenes per hour",
            description="Scenes stored, and scenes mined, attempts included.",
            unit="short",
            queries=(
                Query(f"{per_second('counterpoint_scenes_total')} * 3600", "stored"),
                Query(f"{per_second('counterpoint_worker_scenes_total')} * 3600", "mined"),
            ),
        ),
        Panel(
            title="Plans and shards by state",
            description="Waiting, running and paused work. `ready` that only grows: too few "
            "workers.",
            unit="short",
            queries=(
                Query(
                    'sum by (work, state) (counterpoint_work{state!="done"})', "{{work}} {{state}}"
                ),
            ),
        ),
        Panel(
            title="Age of the oldest work",
            description="Grows by a second per second while one recording is stuck; falls when "
            "the workers catch up.",
            unit="s",
            thresholds=((6 * 3600, YELLOW), (24 * 3600, RED)),
            queries=(Query("max (counterpoint_oldest_work_age_seconds)", "oldest work"),),
        ),
        Panel(
            title="Mined again within a day",
            description="Core-seconds of mining logs again within the last day; 0: nothing is "
            "mined again. The setting `remine_core_hours_a_day` bounds it.",
            unit="s",
            queries=(Query("max (counterpoint_remined_core_seconds)", "mined again"),),
        ),
        Panel(
            title="Recordings by state",
            description="Every recording in the bucket. Refused ones cannot be mined; "
            "`counterpoint status` has the cause.",
            unit="short",
            stacked=True,
            queries=(Query("sum by (state) (counterpoint_recordings)", "{{state}}"),),
        ),
        Panel(
            title="Bucket",
            description="Objects in the bucket at the last listing, and entries that were skipped. "
            "An unexpected fall of the first means that the bucket loses logs.",
            unit="short",
            queries=(
                Query("sum (counterpoint_bucket_objects)", "objects"),
                Query("sum (counterpoint_bucket_skipped_entries)", "skipped entries"),
            ),
        ),
        Panel(
            title="Size of the bucket",
            description="Bytes of the recordings at the last listing.",
            unit="bytes",
            queries=(Query("sum (counterpoint_bucket_bytes)", "bytes"),),
        ),
        Panel(
            title="Workers at work",
            description="Processes alive, those that report a lease, and those that hold one in "
            "the ledger. Alive but idle while shards wait: they cannot reach service "
            "or stores.",
            unit="short",
            queries=(
                Query("sum (counterpoint_worker_processes_wanted)", "wanted"),
                Query("sum (counterpoint_worker_processes_alive)", "alive"),
                Query("sum (counterpoint_worker_connected)", "with a router"),
                Query("sum (counterpoint_worker_busy)", "busy"),
                Query("sum (counterpoint_workers_seen)", "holding a lease"),
            ),
        ),
        Panel(
            title="Scene events not yet published",
            description="On disk, but not yet put on the bus. It only grows while no router is "
            "connected; subscribers then get no new scenes.",
            unit="short",
            thresholds=((1000, YELLOW),),
            queries=(Query("sum (counterpoint_unpublished_events)", "events"),),
        ),
    ),
)

TIME: Final = Row(
    "Time",
    (
        Panel(
            title="Worker seconds per frame by stage",
            description="Together the time that one worker spends on one frame; at 0.1 s one "
            "worker keeps up with one car of 10 frames per second.",
            unit="s",
            width=12,
            stacked=True,
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_stage_seconds_sum', 'stage')}"
                    " / ignoring (stage) group_left () "
                    f"{per_second('counterpoint_worker_frames_total')}",
                    "{{stage}}",
                ),
            ),
        ),
        Panel(
            title="Time of a shard and of a plan",
            description="From lease to commit: half of them take less than the first line of "
            "each, 95 of 100 less than the second.",
            unit="s",
            width=12,
            queries=(
                Query(quantile(0.5, "counterpoint_worker_shard_seconds"), "shard, median"),
                Query(quantile(0.95, "counterpoint_worker_shard_seconds"), "shard, 95 %"),
                Query(quantile(0.5, "counterpoint_worker_plan_seconds"), "plan, median"),
                Query(quantile(0.95, "counterpoint_worker_plan_seconds"), "plan, 95 %"),
            ),
        ),
        Panel(
            title="Bytes read over bytes needed",
            description="Of the log bucket, to mine. 1 is the least; warm-up before each shard is "
            "what comes on top. Above 2, shards are too short for these logs (`grid.shard_s`).",
            unit="short",
            decimals=2,
            thresholds=((2, YELLOW),),
            queries=(
                Query(
                    per_second('counterpoint_worker_bytes_read_total{work="mine"}')
                    + f" / {per_second('counterpoint_worker_bytes_needed_total')}",
                    "read / needed",
                ),
            ),
        ),
        Panel(
            title="Read from the bucket",
            description="Bytes per second, to plan and to mine.",
            unit="Bps",
            stacked=True,
            queries=(
                Query(per_second("counterpoint_worker_bytes_read_total", "work"), "{{work}}"),
            ),
        ),
        Panel(
            title="Requests to the bucket",
            description="Range reads per second, to plan and to mine: what a store may charge for.",
            unit="reqps",
            stacked=True,
            queries=(
                Query(per_second("counterpoint_worker_range_reads_total", "work"), "{{work}}"),
            ),
        ),
        Panel(
            title="Camera pictures kept",
            description="Bytes per second that the setting pictures adds to the artifacts, and "
            "pictures per second.",
            unit="Bps",
            queries=(
                Query(per_second("counterpoint_worker_picture_bytes_total"), "bytes"),
                Query(per_second("counterpoint_worker_pictures_total"), "pictures"),
            ),
        ),
        Panel(
            title="Time to make a commit durable",
            description="Above half a second the disk of the state is too slow, or shared.",
            unit="s",
            thresholds=((0.5, YELLOW),),
            queries=(
                Query(quantile(0.5, "counterpoint_commit_seconds"), "median"),
                Query(quantile(0.99, "counterpoint_commit_seconds"), "99 %"),
            ),
        ),
        Panel(
            title="Time of the last listing",
            description="Near `list_interval_s` the bucket is listed without pause; raise the "
            "interval.",
            unit="s",
            queries=(Query("max (counterpoint_bucket_listing_seconds)", "listing"),),
        ),
        Panel(
            title="Most memory of a worker",
            description="Highest that any worker process alive has held. Workers times this must "
            "fit into the machine.",
            unit="bytes",
            queries=(Query("max (counterpoint_worker_peak_memory_bytes)", "peak"),),
        ),
    ),
)

TROUBLE: Final = Row(
    "Errors",
    (
        Panel(
            title="Leases ended, per hour",
            description="`expired`, `failed` and `worker_died` may each be an attempt lost; the "
            "last one parks the work.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_leases_ended_total', 'reason')} * 3600",
                    "{{reason}}",
                ),
            ),
        ),
        Panel(
            title="Attempts of the workers, per hour",
            description="Shards and plans by how they ended at the worker. `store_away` costs no "
            "attempt.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_shards_total', 'outcome')} * 3600",
                    "shard {{outcome}}",
                ),
                Query(
                    f"{per_second('counterpoint_worker_plans_total', 'outcome')} * 3600",
                    "plan {{outcome}}",
                ),
            ),
        ),
        Panel(
            title="Commits by answer, per hour",
            description="`refused` is void or wrong work; `missing` were records lost on the bus, "
            "sent again.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_commits_total', 'work, outcome')} * 3600",
                    "{{work}} {{outcome}}",
                ),
            ),
        ),
        Panel(
            title="Parked",
            description="Plans and shards that are not tried again until `counterpoint retry`, how "
            "many were added per hour, and how many that verb has opened again.",
            unit="short",
            thresholds=((1, RED),),
            queries=(
                Query('sum by (work) (counterpoint_work{state="parked"})', "{{work}} parked"),
                Query(
                    f"{per_second('counterpoint_work_parked_total', 'work')} * 3600",
                    "{{work}} per hour",
                ),
                Query(
                    f"{per_second('counterpoint_work_retried_total', 'work')} * 3600",
                    "{{work}} tried again, per hour",
                ),
            ),
        ),
        Panel(
            title="Errors of the stores, per hour",
            description="Listings that failed, and leases given up because bucket or artifacts "
            "did not answer or refused. Refused: credentials. Unreachable: network or store.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_bucket_errors_total', 'kind')} * 3600",
                    "listing {{kind}}",
                ),
                Query(
                    f"{per_second('counterpoint_worker_store_errors_total', 'store, kind')} * 3600",
                    "{{store}} {{kind}}",
                ),
            ),
        ),
        Panel(
            title="Workers that wait for a store",
            description="They claim nothing until bucket or artifacts work again.",
            unit="short",
            thresholds=((1, YELLOW),),
            queries=(Query("sum by (store) (counterpoint_worker_waiting_for_store)", "{{store}}"),),
        ),
        Panel(
            title="Errors of the database, per hour",
            description="Transactions that could not be finished: disk full, locked for too long, "
            "or its server away. Nothing acknowledged is lost.",
            unit="short",
            thresholds=((1, RED),),
            queries=(
                Query(f"{per_second('counterpoint_database_errors_total')} * 3600", "errors"),
            ),
        ),
        Panel(
            title="Worker processes replaced, per hour",
            description="Processes that ended unexpectedly, by cause. `crashed` often means too "
            "little memory.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_restarts_total', 'cause')} * 3600",
                    "{{cause}}",
                ),
            ),
        ),
        Panel(
            title="Damage found in logs, per hour",
            description="Stretches that could not be read, and objects without a valid end. The "
            "rest of such a log is mined.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_damaged_chunks_total')} * 3600",
                    "damaged chunks",
                ),
                Query(
                    f"{per_second('counterpoint_worker_truncated_parts_total')} * 3600",
                    "truncated objects",
                ),
            ),
        ),
        Panel(
            title="Logs mined only in part",
            description="Recordings in the bucket now. `truncated`: an object was never closed, "
            "and is mined as far as it goes. `unreadable`: stretches cannot be read, the rest is "
            "mined. `counterpoint status` names each.",
            unit="short",
            stacked=True,
            queries=(Query("sum by (damage) (counterpoint_damaged_recordings)", "{{damage}}"),),
        ),
        Panel(
            title="Stretches that cannot be read",
            description="In the recordings that are in the bucket now, each once. "
            "`counterpoint status` names each.",
            unit="short",
            queries=(Query("max (counterpoint_damaged_stretches)", "stretches"),),
        ),
        Panel(
            title="Logs of which something was noticed",
            description="Recordings in the bucket now of which something was noticed that costs no "
            "byte of them, mostly answers of a model that cannot be used. `counterpoint status` "
            "names each.",
            unit="short",
            queries=(Query("max (counterpoint_noticed_recordings)", "logs"),),
        ),
        Panel(
            title="Frames by health of their pose",
            description="Share of the mined frames. Degraded poses lower a scene's score, lost "
            "ones void it.",
            unit="percentunit",
            most=1,
            stacked=True,
            colours={"healthy": "#56a64b", "degraded": "#e0b400", "lost": "#c4162a"},
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_odometry_frames_total', 'state')}"
                    " / ignoring (state) group_left () "
                    f"{per_second('counterpoint_worker_odometry_frames_total')}",
                    "{{state}}",
                ),
            ),
        ),
        Panel(
            title="Frames without an answer, by why",
            description="Share of the mined frames in which the self-supervised stream judged "
            "nothing. `no_past`: start of a log, or a gap. `no_fit`: the frame contradicts those "
            "before it as a whole, so its pose or time is wrong. Nothing contradicts in such "
            "frames.",
            unit="percentunit",
            most=1,
            stacked=True,
            thresholds=((0.1, YELLOW),),
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_blind_frames_total', 'cause')}"
                    " / ignoring (cause) group_left () "
                    f"{per_second('counterpoint_worker_frames_total')}",
                    "{{cause}}",
                ),
            ),
        ),
        Panel(
            title="What the self-supervised stream says",
            description="Share of the returns by its answer. When `unknown` rises it finds "
            "nothing, and nothing contradicts.",
            unit="percentunit",
            most=1,
            stacked=True,
            colours={"static": "#8a8f98", "dynamic": "#e0752d", "unknown": "#3a3d42"},
            queries=(
                Query(
                    f"{per_second('counterpoint_worker_motion_points_total', 'label')}"
                    " / ignoring (label) group_left () "
                    f"{per_second('counterpoint_worker_motion_points_total')}",
                    "{{label}}",
                ),
            ),
        ),
        Panel(
            title="How well frames fit",
            description="Distance of static structure to the frame before, by scene, and frames "
            "per hour whose pose went where no car goes.",
            unit="short",
            queries=(
                Query(quantile(0.5, "counterpoint_worker_static_residual_m"), "residual, m"),
                Query(quantile(0.95, "counterpoint_worker_static_residual_m"), "residual, 95 %"),
                Query(
                    f"{per_second('counterpoint_worker_pose_jumps_total')} * 3600",
                    "jumps per hour",
                ),
            ),
        ),
        Panel(
            title="Places that were seen before",
            description="Share of what the self-supervised stream was asked about that an earlier "
            "frame saw or saw through, by scene. Below a half: beams or origin of the sensor are "
            "wrong.",
            unit="percentunit",
            most=1,
            thresholds=((0.5, YELLOW),),
            queries=(
                Query(quantile(0.5, "counterpoint_worker_seen_share"), "median"),
                Query(quantile(0.05, "counterpoint_worker_seen_share"), "lowest 5 %"),
            ),
        ),
        Panel(
            title="Records lost on the bus, per hour",
            description="Noticed, and sent again in the commit. Also: renewals of leases without "
            "an answer.",
            unit="short",
            queries=(
                Query(f"{per_second('counterpoint_bus_misses_total')} * 3600", "records"),
                Query(
                    f"{per_second('counterpoint_worker_lease_renewals_failed_total')} * 3600",
                    "renewals",
                ),
            ),
        ),
    ),
)

INSIDE: Final = Row(
    "Inside the service",
    (
        Panel(
            title="Questions by verb",
            description="What workers, subscribers and people ask, per second.",
            unit="reqps",
            stacked=True,
            queries=(Query(per_second("counterpoint_questions_total", "verb"), "{{verb}}"),),
        ),
        Panel(
            title="Questions not answered, per hour",
            description="`try_again`: the service is too busy, or its database does not answer. "
            "`malformed`: a client of another version.",
            unit="short",
            queries=(
                Query(
                    per_second('counterpoint_questions_total{outcome!="answered"}', "outcome")
                    + " * 3600",
                    "{{outcome}}",
                ),
            ),
        ),
        Panel(
            title="Questions waiting",
            description="In the queue. Some hundred, for long: the disk of the state is too slow "
            "for so many workers.",
            unit="short",
            thresholds=((200, YELLOW),),
            queries=(Query("sum (counterpoint_questions_waiting)", "waiting"),),
        ),
        Panel(
            title="Leases held",
            description="Leases that are out now: one per worker at work.",
            unit="short",
            queries=(Query("sum (counterpoint_leases_held)", "leases"),),
        ),
        Panel(
            title="Records waiting for their commit",
            description="Bytes in memory. At 64 MiB the oldest are dropped, and sent again.",
            unit="bytes",
            thresholds=((48 * 1024**2, YELLOW), (64 * 1024**2, RED)),
            queries=(Query("sum (counterpoint_staging_bytes)", "bytes"),),
        ),
        Panel(
            title="Webhooks that wait",
            description="Time for which the receiver in the worst state has taken no event.",
            unit="s",
            thresholds=((60, YELLOW), (600, RED)),
            queries=(Query("max (counterpoint_webhooks_late_seconds)", "late"),),
        ),
        Panel(
            title="Webhook attempts and new modes, per hour",
            description="Deliveries by outcome, and failure modes that were not there before.",
            unit="short",
            queries=(
                Query(
                    f"{per_second('counterpoint_webhook_attempts_total', by='outcome')} * 3600",
                    "{{outcome}}",
                ),
                Query(f"{per_second('counterpoint_new_modes_total')} * 3600", "new modes"),
            ),
        ),
        Panel(
            title="Overlays deleted, per hour",
            description="Of scenes withdrawn `keep_withdrawn_days` ago, or beyond "
            "`artifacts_budget_bytes`. Without these settings the artifacts only grow.",
            unit="short",
            queries=(
                Query(f"{per_second('counterpoint_overlays_deleted_total')} * 3600", "overlays"),
            ),
        ),
        Panel(
            title="Overlays and their budget",
            description="Bytes of all overlays, and the setting `artifacts_budget_bytes`.",
            unit="bytes",
            queries=(
                Query("max (counterpoint_artifacts_bytes)", "overlays"),
                Query("max (counterpoint_artifacts_budget_bytes)", "budget"),
            ),
        ),
        Panel(
            title="Free space for the state",
            description="Of the disk with the state folder.",
            unit="bytes",
            queries=(Query("min (counterpoint_state_free_bytes)", "free"),),
        ),
        Panel(
            title="Services: active and standby",
            description="One service serves; standbys are counted where `standby` is set.",
            unit="short",
            queries=(
                Query("sum (counterpoint_service_active)", "active"),
                Query("max (counterpoint_service_standbys)", "standby"),
            ),
        ),
        Panel(
            title="Version",
            description="Which versions run. Two at a time: an upgrade is half done.",
            unit="short",
            width=24,
            height=5,
            queries=(
                Query("sum by (version, job) (counterpoint_build_info)", "{{version}} {{job}}"),
            ),
        ),
    ),
)

DASHBOARD: Final = Dashboard(
    uid="counterpoint-operation",
    title="Counterpoint: operation",
    description="Is it alive, does it keep up, what goes wrong.",
    since="now-6h",
    rows=(NOW, PROGRESS, TIME, TROUBLE, INSIDE),
)
