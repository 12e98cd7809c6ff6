"""Client library: the verbs of the service, and a subscription to scored scenes."""

from schemas.transport.locks import Locks as Locks
from service.client.client import ControlClient as ControlClient
from service.client.counterpoint import Counterpoint as Counterpoint
from service.client.watching import watch_scenes as watch_scenes
