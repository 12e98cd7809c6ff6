"""Types of the events that webhooks send."""

from typing import Final, Literal, get_args

EventType = Literal["scene.new", "selection.made", "mode.new", "gate.compared"]
"""Types of events, as the setting `webhook_events` names them."""

EVENTS: Final = get_args(EventType)
