"""Messages about settings: accepted values and errors, without any secret."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from schemas.bounds import NO_NUL
from service.settings.hidden_passwords import in_sentence, shown
from service.settings.sources import Written


def allowed(model: type[BaseModel]) -> dict[str, str]:
    """Describe the accepted values of every setting, by its dotted name."""
    schema = model.model_json_schema()
    return _allowed(schema["properties"], schema.get("$defs", {}), "")


def impossible(
    error: ValidationError, laid: Mapping[str, Written], allowed_of: Mapping[str, str]
) -> list[str]:
    """Describe the errors, each by the name that the user gave.

    Args:
        error: Error of the model.
        laid: Written value of each setting.
        allowed_of: Accepted values of each setting.
    """
    sentences = []
    for each in error.errors(include_url=False, include_context=False):
        place = ".".join(str(part) for part in each["loc"] if not isinstance(part, int))
        why = each["msg"].removeprefix("Value error, ").removeprefix("Input ")
        if place in laid:
            written = laid[place]
            rule = why if each["type"] == "value_error" else allowed_of[place]
            named = f" (setting {place})" if written.kind == "flag" and "." in place else ""
            sentences.append(f"{written.quoted(_quoted_value(written))}: must be {rule}{named}")
        else:  # several settings that do not go together
            inside = [w for name, w in sorted(laid.items()) if name.startswith(f"{place}.")]
            what = ", ".join(w.quoted(_quoted_value(w)) for w in inside) or place or "settings"
            sentences.append(f"{what}: {shown(why)}")
    return sentences


def _quoted_value(written: Written) -> str:
    text = in_sentence(written.value)
    return f'"{text}"' if written.kind == "file" and isinstance(written.value, str) else text


def _allowed(
    properties: Mapping[str, Any], definitions: Mapping[str, Any], prefix: str
) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, schema in properties.items():
        if "$ref" in schema:
            inner = definitions[schema["$ref"].rpartition("/")[2]]["properties"]
            found |= _allowed(inner, definitions, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = _in_words(schema)
    return found


def _in_words(schema: Mapping[str, Any]) -> str:
    if "enum" in schema:
        return " or ".join(map(str, schema["enum"]))
    kind = schema.get("type", "")
    if kind == "array":
        most = f" of at most {schema['maxItems']}" if "maxItems" in schema else ""
        return f"a list{most}"
    if kind in ("integer", "number"):
        return " ".join(["a whole number" if kind == "integer" else "a number", *_bounds(schema)])
    if schema.get("pattern") == NO_NUL and "maxLength" in schema:
        return f"text of at most {schema['maxLength']} characters"
    if "pattern" in schema:
        return f"text like {schema['pattern']}"
    return "a path" if schema.get("format") == "path" else "text"


def _bounds(schema: Mapping[str, Any]) -> list[str]:
    low, above = schema.get("minimum"), schema.get("exclusiveMinimum")
    high, below = schema.get("maximum"), schema.get("exclusiveMaximum")
    bounds = []
    if low is not None and high is not None:
        return [f"from {low:g} to {high:g}"]
    if low is not None:
        bounds.append(f"of at least {low:g}")
    if above is not None:
        bounds.append(f"above {above:g}")
    if high is not None:
        bounds.append(f"{'and ' if bounds else ''}at most {high:g}")
    if below is not None:
        bounds.append(f"{'and ' if bounds else ''}below {below:g}")
    return bounds
