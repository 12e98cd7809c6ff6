"""Entry point of the command, which loads nothing itself.

Every worker process begins by reading this file again, and needs none of the verbs.
"""

import os
import sys


def open_closed_streams() -> None:
    """Put /dev/null where stdin, stdout or stderr are closed.

    Python has None for such a stream, and the next file that is opened, such as a database, would
    get its number: what a library writes to stderr would go there.
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
    """Load the verbs, and run the one that is asked for."""
    open_closed_streams()
    from service.cli.main import console as run

    run()


if __name__ == "__main__":
    console()
