"""One row of the catalogue of parts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from workers.parts.files import PartFiles

if TYPE_CHECKING:
    from workers.checkpoints.stored_weights import Card
    from workers.contradiction.settings import InstanceSettings
    from workers.parts.protocols import Odometry, Stream, Witness

PartSetting = Literal["odometry", "supervised", "selfsupervised", "witness", "instances"]
"""The settings that name a part."""

PartKind = PartSetting | Literal["network"]
"""A network is no setting: streams and odometries are made of networks."""

KINDS: Final[Mapping[PartKind, str]] = {
    "odometry": "odometry",
    "supervised": "supervised stream",
    "selfsupervised": "self-supervised stream",
    "witness": "witness",
    "instances": "rule of instances",
    "network": "network",
}
"""Every kind, in the order in which it is listed, with its name in a sentence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part that a setting can name, or a network that parts are made of.

    `text`, `source`, `licence` and `weights` are for readers. They are not part of the pipeline
    version (`workers.sources`), so a corrected sentence mines no log again.

    Attributes:
        kind: The setting that names it, or `network`.
        name: Its value in that setting.
        factory: Builds it, and imports what it is made of only then. The factory of a network
            returns the type of the card of its weights.
        text: What it does, in a sentence.
        source: Where the method is from.
        licence: Licence of the code that runs.
        networks: Names of the networks whose weights it loads.
        ships: Whether the weights of these networks come with the package.
        weights: What weights it needs and whether they ship; empty: follows from `networks`.
        paper: Whether it is a part of the paper's chain.
    """

    kind: PartKind
    name: str
    factory: "Callable[[PartFiles], Odometry | Stream | Witness | InstanceSettings | type[Card]]"
    text: str
    source: str
    licence: str = "Apache-2.0"
    networks: tuple[str, ...] = ()
    ships: bool = False
    weights: str = ""
    paper: bool = False

    @property
    def weights_needed(self) -> str:
        """Describe the weights it needs; `none`: nothing."""
        if self.weights or not self.networks:
            return self.weights or "none"
        return f"{' and '.join(self.networks)}, trained or imported; none ship"
