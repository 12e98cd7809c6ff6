"""Options that several verbs take together, once: a dataclass whose fields are options."""

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from inspect import Parameter, signature
from typing import Any, get_type_hints

from service.cli.options import (
    Camera,
    Model,
    Odometry,
    Predictions,
    PresetName,
    SelfSupervised,
    Supervised,
    Weights,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MiningOptions:
    """Options of every verb that mines: by which parts."""

    supervised: Supervised = None
    model: Model = None
    weights: Weights = None
    predictions: Predictions = None
    odometry: Odometry = None
    camera: Camera = None
    preset: PresetName = None
    selfsupervised: SelfSupervised = None

    def flags(self) -> dict[str, str | None]:
        """Return what was given, as `service.settings.config.read_settings` takes it.

        A folder of predictions is read by the stream `recorded`, unless another one is named.
        """
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.predictions and self.supervised is None:
            given["supervised"] = "recorded"
        return given


def grouped(verb: Callable[..., None]) -> Callable[..., None]:
    """Give a verb the options of each parameter whose type is a group, in place of the parameter.

    Args:
        verb: Takes its groups by keyword.

    Returns:
        The verb as Typer reads and calls it: every option is a parameter of its own.
    """
    groups: dict[str, type[Any]] = {}
    parameters: list[Parameter] = []
    for parameter in signature(verb).parameters.values():
        kind = parameter.annotation
        if not (isinstance(kind, type) and is_dataclass(kind)):
            parameters.append(parameter.replace(kind=Parameter.KEYWORD_ONLY))
            continue
        groups[parameter.name] = kind
        types = get_type_hints(kind, include_extras=True)
        parameters += [
            Parameter(
                field.name,
                Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=types[field.name],
            )
            for field in fields(kind)
        ]

    @wraps(verb)
    def called(**given: Any) -> None:
        made = {
            name: group(**{field.name: given.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        verb(**given, **made)

    called.__signature__ = signature(verb).replace(parameters=parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in parameters}
    return called
