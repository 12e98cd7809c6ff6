"""Client library: the verbs of the service, and a subscription to scored scenes."""

from service.client.client import ControlClient as ControlClient
from service.client.client import watch_scenes as watch_scenes
