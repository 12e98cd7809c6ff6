"""The S3 gateway in front of logs and overlays: killed, frozen, cut off."""

import signal
import tempfile
from contextlib import ExitStack
from pathlib import Path

from schemas.transport.bucket import Bucket
from tests.chaos.parts import SERVERS
from tests.integration.cutting_proxy import CuttingProxy
from tests.integration.object_store import Ceph


class Gateway:
    """A Ceph gateway with a bucket of logs and one of overlays.

    Attributes:
        network: Between all processes and the gateway.
        logs: Name of the bucket of logs; `overlays`: of the other one.
        environment: Variables under which a process reaches it through the network.
    """

    def __init__(self, opened: ExitStack) -> None:
        """Start the store.

        Args:
            opened: Ends it.
        """
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="ceph-")))
        self._ceph = Ceph(SERVERS, folder)
        opened.callback(self._ceph.down)
        self._ceph.up()
        self.logs, self.overlays = self._ceph.make_bucket(), self._ceph.make_bucket()
        port = int(self._ceph.endpoint.rpartition(":")[2])
        self.network = opened.enter_context(CuttingProxy(port))
        through = f"http://127.0.0.1:{self.network.port}"
        self.environment = self._ceph.environment(endpoint=through)

    def open(self, name: str) -> Bucket:
        """Open a bucket directly, past the network."""
        return self._ceph.open(name)

    def kill(self) -> None:
        """Kill the gateway."""
        self._ceph.kill()

    def start(self) -> None:
        """Start the gateway again."""
        self._ceph.start()

    def freeze(self) -> None:
        """Stop the gateway, which keeps all connections open."""
        self._ceph.send(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let the gateway continue."""
        self._ceph.send(signal.SIGCONT)
