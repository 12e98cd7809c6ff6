"""Entry point of the command, free of imports of its own.

Every worker process reads this file again at its start, and needs none of the verbs.
"""

import os
import sys


def open_closed_streams() -> None:
    """Open /dev/null in place of closed stdin, stdout or stderr.

    Python represents such a stream as None. The next file that is opened, such as a database, would
    get its descriptor, and a library's messages on stderr would be written into it.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the least free number, which is this one
            os.set_inheritable(opened, True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def console() -> None:
    """Import the verbs, and run the requested one."""
    open_closed_streams()
    from service.cli.main import console as run

    run()


if __name__ == "__main__":
    console()
