"""The client that users import: verbs of the service, and scenes as they come."""

from service.client.client import ControlClient as ControlClient
from service.client.client import watch_scenes as watch_scenes
