"""Entry point of the command, which loads nothing itself.

Every worker process begins by reading this file again, and needs none of the verbs.
"""


def console() -> None:
    """Load the verbs, and run the one that is asked for."""
    from service.cli.main import console as run

    run()


if __name__ == "__main__":
    console()
