"""Page of the REST API for people, rendered from its OpenAPI document by our own files."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from schemas.visible import visible
from service.api.routes import PREFIX

router = APIRouter()

TEMPLATES: Final = Path(__file__).resolve().parent / "templates"

_ENVIRONMENT: Final = Environment(
    loader=FileSystemLoader(TEMPLATES),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)

_BOUNDS: Final = {
    "minimum": "at least {}",
    "exclusiveMinimum": "above {}",
    "maximum": "at most {}",
    "exclusiveMaximum": "below {}",
    "maxLength": "at most {} characters",
    "maxItems": "at most {} items",
}


@dataclass(frozen=True, slots=True)
class Field:
    """A parameter, or a field of a body or model.

    Attributes:
        name: Its name.
        where: `query`, `path`, `header`; empty for a field of JSON.
        kind: Type and bounds, as HTML.
        is_required: True if it must be given.
        text: Its description.
    """

    name: str
    where: str
    kind: Markup
    is_required: bool
    text: str


@dataclass(frozen=True, slots=True)
class Operation:
    """One route, as the page shows it.

    Attributes:
        method: GET or POST.
        path: Path on this host.
        tag: Group of routes.
        summary: Title.
        text: Description.
        parameters: Parameters of path, query and header.
        body: Type of the JSON body, as HTML; empty without one.
        reply: Type of the answer, as HTML; empty for bytes.
    """

    method: str
    path: str
    tag: str
    summary: str
    text: str
    parameters: tuple[Field, ...]
    body: Markup
    reply: Markup


@router.get("/", include_in_schema=False)
def page(request: Request) -> Response:
    """Answer with the page of the routes and models."""
    document = request.app.openapi()
    return HTMLResponse(reference_page(document))


def reference_page(document: Mapping[str, Any]) -> str:
    """Render the page of an OpenAPI document."""
    models = document["components"]["schemas"]
    return _ENVIRONMENT.get_template("reference.html").render(
        about=document["info"],
        prefix=PREFIX,
        operations=list(_operations(document["paths"])),
        models={
            name: (model.get("description", "").split("\n")[0], list(_fields(model)))
            for name, model in sorted(models.items())
            if model.get("properties")
        },
    )


def _operations(paths: Mapping[str, Any]) -> Iterator[Operation]:
    for path, methods in paths.items():
        for method, about in methods.items():
            content = about.get("requestBody", {}).get("content", {})
            replies = [
                each["schema"]
                for status in ("200", "201", "202")
                for kind, each in about["responses"].get(status, {}).get("content", {}).items()
                if kind == "application/json" and each.get("schema")
            ]
            yield Operation(
                method=method.upper(),
                path=f"{PREFIX}{path}",
                tag=about.get("tags", [""])[0],
                summary=about["summary"],
                text=about.get("description", ""),
                parameters=tuple(_parameters(about)),
                body=_kind(content["application/json"]["schema"]) if content else Markup(),
                reply=_kind(replies[0]) if replies else Markup(),
            )


def _parameters(about: Mapping[str, Any]) -> Iterator[Field]:
    for each in about.get("parameters", ()):
        text = each.get("description") or each["schema"].get("description", "")
        yield Field(
            each["name"], each["in"], _kind(each["schema"]), each.get("required", False), text
        )


def _fields(model: Mapping[str, Any]) -> Iterator[Field]:
    needed = model.get("required", ())
    for name, schema in model["properties"].items():
        yield Field(name, "", _kind(schema), name in needed, schema.get("description", ""))


def _kind(schema: Mapping[str, Any]) -> Markup:
    """Describe the type of a value; the name of a model links to its fields."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return Markup('<a href="#{0}">{0}</a>').format(name)
    if several := schema.get("anyOf") or schema.get("allOf"):
        return Markup(" or ").join(_kind(each) for each in several)
    if "enum" in schema:
        return escape(", ".join(map(str, schema["enum"])))
    if "const" in schema:
        return escape(schema["const"])
    if schema.get("type") == "array":
        inner = _kind(schema["items"]) if "items" in schema else Markup("values")
        return Markup("list of {}").format(inner)
    kind = str(schema.get("type", "value"))
    bounds = [words.format(schema[key]) for key, words in _BOUNDS.items() if key in schema]
    default = schema.get("default")
    if default not in (None, ""):
        bounds.append(f"usually {default}")
    return escape(visible(", ".join((kind, *bounds))))
