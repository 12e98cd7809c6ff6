"""`counterpoint router`: a Zenoh router and nothing else; it keeps no state."""

from collections.abc import Callable

from schemas.bus import router_session
from schemas.process import stop_on_signals


def run_router(listen: str, *, on_ready: Callable[[str], None], connect: str = "") -> None:
    """Route until told to stop by SIGTERM or SIGINT.

    Args:
        listen: Endpoints to listen on, commas between.
        on_ready: Told in one sentence where it listens.
        connect: Other routers to link to, so that clients may list several and lose one.

    Raises:
        TransientError: If an endpoint is taken.
        PermanentError: If an endpoint cannot be listened on here at all.
    """
    others = connect.split(",") if connect else []
    with stop_on_signals() as stop, router_session(listen.split(","), connect=others):
        on_ready(f"routing at {listen}")
        stop.wait()
