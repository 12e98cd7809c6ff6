"""The ranking of a ledger by what its verdicts teach."""

from service.api.messages import Learned, TopReply
from service.curation.learned import learned_ranking
from service.store.ledger import Ledger


def learned_top(ledger: Ledger, *, most: int | None) -> TopReply:
    """Rank every current scene by what verdicts teach, where this is better, with its effect.

    Args:
        ledger: Scenes and verdicts.
        most: Number of rows at most; None: all.

    Raises:
        UsageError: If the verdicts are too few, or of a single log.
    """
    rows, chances, effect = learned_ranking(ledger.ranking(), ledger.verdicts.current())
    shown = ledger.verdicts.with_verdicts(rows[:most])
    return TopReply(
        scenes=tuple(shown), learned=Learned(effect=effect, chances=tuple(chances[:most]))
    )
