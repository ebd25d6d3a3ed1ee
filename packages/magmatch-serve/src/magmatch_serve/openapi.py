# SPDX-License-Identifier: BSD-3-Clause
"""The service describes its answers, as an OpenAPI document and as a page that needs nothing from elsewhere."""

from functools import cache
from html import escape
from typing import Any

from pydantic import TypeAdapter

from magmatch import __version__
from magmatch.data.formats.format import SurveyFormat
from magmatch.localization.result import LocalizationResult
from magmatch.registration.result import RegistrationResult
from magmatch_serve.logs.work import QUESTIONS, Verb
from magmatch_serve.messages import Hello, Sample, Samples

REFUSALS = {
    400: "The request cannot be read",
    401: "The token is missing or wrong",
    403: "Pages of this origin may not ask",
    404: "Nothing is at this path, or no such map",
    405: "The path takes another method",
    408: "The body came too slowly",
    413: "The body, what it unpacks to or the log is too long",
    415: "A body of this coding is not read",
    421: "The Host is not this machine's",
    422: "The log or a word of the query cannot be",
    429: "More requests than an address may make",
    500: "The service made a mistake",
    501: "Such logs are not read here",
    503: "There is no room now; try again later",
}
LIVE = (
    "A WebSocket. The client says hello (schema Hello) and is told its key; each message of samples (schema Sample "
    "or Samples, or binary rows) is answered by one pose or one error. A refusal closes it with 4000 and the status."
)


@cache
def openapi() -> dict[str, Any]:
    """Write the document."""
    document: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {"title": "magmatch", "version": __version__, "description": "Where bodies are in a magnetic map."},
        "paths": {
            "/localize": {
                "post": {"summary": "Where a log's body was in the map"} | _log("localize") | _answers("Localization")
            },
            "/register": {
                "post": {"summary": "A survey's pose in the map"} | _log("register") | _answers("Registration")
            },
            "/maps": {"get": {"summary": "The maps that are served, and their version"} | _answers()},
            "/maps/{name}": {
                "get": {
                    "summary": "A map from above: magnitude of the field, uT",
                    "parameters": [{"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}],
                }
                | _answers()
            },
            "/health": {"get": {"summary": "Whether every process answers", "security": []} | _answers()},
            "/metrics": {"get": {"summary": "Counts in Prometheus' text form"} | _answers()},
            "/live": {"get": {"summary": "Samples in, poses out", "description": LIVE} | _answers()},
            "/watch": {"get": {"summary": "A WebSocket of what the page draws"} | _answers()},
        },
        "components": {
            "schemas": {},
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{"token": []}, {}],
    }
    schemas = document["components"]["schemas"]
    answers = (("Localization", LocalizationResult), ("Registration", RegistrationResult))
    for name, kind in (("Hello", Hello), ("Sample", Sample), ("Samples", Samples), *answers):
        schema = TypeAdapter(kind).json_schema(ref_template="#/components/schemas/{model}")
        schemas.update(schema.pop("$defs", {}))
        schemas[name] = schema
    for name, _ in answers:
        schemas[name]["properties"]["warnings"] = {"type": "array", "items": {"type": "string"}}
    row = {"type": "array", "items": {"type": "number"}, "minItems": 8, "maxItems": 8}
    words = "Stated poses: t, x, y, z, qx, qy, qz, qw."
    schemas["Localization"]["properties"]["trajectory"] = {"type": "array", "items": row, "description": words}
    schemas["Refusal"] = {
        "type": "object",
        "properties": {"type": {"const": "error"}, "status": {"type": "integer"}, "message": {"type": "string"}},
    }
    return document


def _log(verb: Verb) -> dict[str, Any]:
    """A log as the body, and the words of the query."""
    body = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    question, formats = QUESTIONS[verb], SurveyFormat.model_fields
    words = []
    # What is asked first, then how the log is to be read.
    for name, schema in sorted(question.model_json_schema()["properties"].items(), key=lambda one: one[0] in formats):
        if name in question.words():
            said = {"description": schema.pop("description")} if "description" in schema else {}
            words.append({"name": name, "in": "query", "required": False, "schema": schema} | said)
    return {"requestBody": {"required": True, "content": body}, "parameters": words}


def _answers(schema: str | None = None) -> dict[str, Any]:
    said = {} if schema is None else {"content": _json(schema)}
    refusal = {"content": _json("Refusal")}
    return {
        "responses": {"200": {"description": "The answer", **said}}
        | {str(status): {"description": words, **refusal} for status, words in REFUSALS.items()}
    }


def _json(schema: str) -> dict[str, Any]:
    return {"application/json": {"schema": {"$ref": f"#/components/schemas/{schema}"}}}


@cache
def openapi_page() -> str:
    """Write the document for people."""
    document = openapi()
    parts = []
    for path, methods in document["paths"].items():
        for method, about in methods.items():
            words = escape(about.get("description", ""))
            rows = "".join(
                f"<tr><th scope=row>{escape(p['name'])}</th><td>{escape(p.get('description', ''))}</td></tr>"
                for p in about.get("parameters", [])
            )
            table = f"<table>{rows}</table>" if rows else ""
            title = f"<code>{method.upper()} {escape(path)}</code>"
            parts.append(f"<h2>{title}</h2><p>{escape(about['summary'])}. {words}</p>{table}")
    refusals = "".join(f"<tr><th scope=row>{code}</th><td>{escape(w)}</td></tr>" for code, w in REFUSALS.items())
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>magmatch: paths</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,"><link rel="stylesheet" href="/page.css"></head>'
        '<body class="words"><main><h1>What is asked at which path</h1>'
        '<p>The same as <a href="/openapi.json">an OpenAPI document</a>.</p>'
        f"{''.join(parts)}<h2>Refusals</h2><table>{refusals}</table></main></body></html>"
    )
