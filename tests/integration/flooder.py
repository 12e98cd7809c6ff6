"""Clients that ask for the status as fast as they are answered, until the process is ended."""

import sys
import threading

from schemas.errors import CounterpointError
from schemas.transport import keys
from schemas.transport.ask import ask
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT


def main(endpoint: str, clients: int) -> None:
    answered = [threading.Event() for _ in range(clients)]

    def flood(first: threading.Event) -> None:
        with client_session([endpoint]) as session:
            while True:
                try:
                    ask(session, keys.control(root=DEFAULT_ROOT, verb="status"), timeout_s=20)
                except CounterpointError:
                    continue
                first.set()

    for each in answered:
        threading.Thread(target=flood, args=(each,)).start()
    for each in answered:
        each.wait()
    sys.stdout.write("flooding\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
