"""Stands before a TCP server and cuts the network: silently, or by closing all connections."""

import socket
import threading
from contextlib import suppress
from typing import Final, Self

_CHUNK: Final = 1 << 16


class CuttingProxy:
    """A proxy for one server of the loopback, for as long as the `with` block lasts.

    While it is cut, connections stay open and nothing passes, as behind a broken network.

    Attributes:
        port: Its port on the loopback.
    """

    def __init__(self, port: int) -> None:
        """Listen; nothing is cut before it is asked for.

        Args:
            port: Port of the server.
        """
        self._upstream = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._passes = threading.Event()
        self._passes.set()
        self._lock = threading.Lock()
        self._open: set[socket.socket] = set()
        self._ended = False

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._passes.set()
        self.drop()

    def cut(self) -> None:
        """Let nothing pass until `heal`."""
        self._passes.clear()

    def heal(self) -> None:
        """Let everything pass; connections from before the cut are broken, as by a firewall."""
        self.drop()
        self._passes.set()

    def drop(self) -> None:
        """Close every connection."""
        with self._lock:
            broken, self._open = self._open, set()
        for each in broken:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _accept(self) -> None:
        while not self._ended:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(("127.0.0.1", self._upstream), timeout=5)
            except OSError:  # the server is away
                near.close()
                continue
            far.settimeout(None)
            with self._lock:
                self._open |= {near, far}
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(source, sink), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(_CHUNK):
                self._passes.wait()
                sink.sendall(data)
        for each in (source, sink):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            with self._lock:
                self._open.discard(each)
            each.close()
