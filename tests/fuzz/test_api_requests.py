"""Requests at random, sensible and not, made from the OpenAPI document. Oracle: no request is the server's fault.

Whatever comes in, the answer is no 5xx, and from 400 on it is a problem document.
"""

import asyncio
import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plumbline.api import Feed, NoControl, create_app
from plumbline.api.documents import openapi
from plumbline.config import ServerSettings, StationSettings
from plumbline.records import AlertEvent, AlertState, Severity, Solution, Status, Threshold
from plumbline.store import Store

DOCUMENT = openapi()
OPERATIONS = sorted(
    (method, path) for path, methods in DOCUMENT["paths"].items() for method in methods if path.startswith("/v1/")
)
T0 = 1_400_000_000_000_000_000
WORDS = [
    "a",
    "t",
    "x",
    "mm",
    "auto",
    "1s",
    "csv",
    "mseed",
    "2026-01-01T00:00:00Z",
    "2026-13-01T00:00:00Z",
    "0001-01-01T00:00:00Z",
]
WORDS += [
    "2016-12-31T23:59:60Z",
    "displacement_up",
    "active",
    "WyJhIl0",
    "WzFd",
    "null",
    "-1",
    "1e400",
    "9" * 40,
    "true",
    "\x00",
]

texts = st.sampled_from(WORDS) | st.text(max_size=20)
numbers = st.integers() | st.floats() | st.sampled_from([0, 1, -1, 2**63, -(2**63) - 1, 1e308])
json_values = st.recursive(
    st.none() | st.booleans() | numbers | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
accepts = st.sampled_from(
    ["*/*", "*/*", "*/*", "text/csv", "application/json;q=x", "image/*", "", "text/csv;q=0, */*;q=2", ";;,,"]
)


def resolved(schema: dict[str, Any]) -> dict[str, Any]:
    """A schema behind its reference."""
    while "$ref" in schema:
        schema = DOCUMENT["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]]
    return schema


def body_of(schema: dict[str, Any]) -> st.SearchStrategy[Any]:
    """Values that nine times out of ten have a schema's form."""
    schema = resolved(schema)
    kinds = [body_of(part) for part in schema.get("anyOf", ())]
    if "enum" in schema:
        kinds.append(st.sampled_from(schema["enum"]))
    elif "properties" in schema:
        fields = {name: body_of(part) for name, part in schema["properties"].items()}
        required = {name: fields[name] for name in schema.get("required", ())}
        optional = {name: value for name, value in fields.items() if name not in required}
        kinds.append(st.fixed_dictionaries(required, optional=optional) | st.fixed_dictionaries(required))
    elif schema.get("type") == "array":
        items = [body_of(part) for part in schema.get("prefixItems", ())]
        kinds.append(st.tuples(*items).map(list) if items else st.lists(body_of(schema.get("items", {})), max_size=3))
    elif schema.get("type") in PLAIN:
        kinds.append(PLAIN[schema["type"]](schema))
    odd = st.integers(0, 9).flatmap(lambda n: st.one_of(kinds) if kinds and n else json_values)
    return odd if kinds else json_values


def text_of(schema: dict[str, Any]) -> st.SearchStrategy[str]:
    """Text that has a chance of being the right one."""
    if schema.get("format") == "date-time":
        return st.datetimes(datetime(1990, 1, 1), datetime(2100, 1, 1)).map(lambda t: t.isoformat() + "Z")
    return st.sampled_from(["a", "t", "displacement_up", "velocity_east", "GE"]) if "pattern" in schema else texts


PLAIN = {
    "string": text_of,
    "number": lambda schema: st.floats(max(schema.get("minimum", 0), -1e6), min(schema.get("maximum", 1e6), 1e6)),
    "integer": lambda schema: st.integers(schema.get("minimum", -5), schema.get("maximum", 70_000)),
    "boolean": lambda _: st.booleans(),
    "null": lambda _: st.none(),
}


@st.composite
def requests(draw: st.DrawFn) -> dict[str, Any]:
    """One request to one of the operations."""
    method, path = draw(st.sampled_from(OPERATIONS))
    operation = DOCUMENT["paths"][path][method]
    query: list[tuple[str, str]] = []
    for parameter in operation.get("parameters", ()):
        if parameter["in"] == "path":
            name = draw(st.sampled_from(["a"] * 3 + ["t"] * 3 + ["x"] * 3 + ["2d711642b726b044"]) | texts)
            path = path.replace("{" + parameter["name"] + "}", quote(name, safe=""))
        elif parameter["in"] == "query" and draw(st.integers(0, 3)) == 0:
            value = draw(body_of(parameter["schema"]))
            query.append((parameter["name"], value if isinstance(value, str) else json.dumps(value)))
    if draw(st.integers(0, 19)) == 0:
        query.append((draw(texts), draw(texts)))
    request: dict[str, Any] = {"method": method.upper(), "url": path, "params": query}
    request["headers"] = {"accept": draw(accepts), "if-match": draw(st.sampled_from(['"1"', "*", "*", "*", "W/", ""]))}
    if "requestBody" in operation and draw(st.integers(0, 19)):
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        request["content"] = json.dumps(draw(body_of(schema))).encode()
        request["headers"]["content-type"] = draw(st.sampled_from(["application/json"] * 9 + ["text/plain"]))
    elif draw(st.integers(0, 9)) == 0:
        request["content"] = draw(st.binary(max_size=30))
    return request


class Bench:
    """The application, some content, and a loop to ask it in."""

    def __init__(self, path: Path) -> None:
        self.loop = asyncio.new_event_loop()
        self.store = self.run(Store.open(f"sqlite:///{path / 'fuzz.sqlite'}", readers=1))
        self.app = create_app(self.store, Feed(), NoControl(), ServerSettings())
        transport = httpx.ASGITransport(app=self.app, raise_app_exceptions=False)
        self.client = httpx.AsyncClient(transport=transport, base_url="http://p")

    def run(self, work: Any) -> Any:
        """Await something."""
        return self.loop.run_until_complete(work)

    def fill(self) -> None:
        """One of each thing, so that requests find something."""
        settings_ = StationSettings(station="a", reference_position_ecef_m=(4e6, 0.0, 5e6))
        event = AlertEvent(
            "x", "a", "t", AlertState.ACTIVE, Severity.ALARM, T0, T0, T0, "displacement_up", 1.0, 0.5, ""
        )
        self.run(self.store.seed([settings_], [Threshold("t", "a", "displacement_up", 0.5)]))
        self.run(self.store.write([event, Solution("a", T0, T0, Status.NO_BASE, "")]))

    def close(self) -> None:
        """Let go of everything."""
        self.run(self.client.aclose())
        self.run(self.store.close())
        self.loop.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """A filled application."""
    made = Bench(tmp_path)
    yield made
    made.close()


@settings(max_examples=600, deadline=None, suppress_health_check=list(HealthCheck))
@given(request=requests())
def test_no_request_is_the_servers_fault(bench: Bench, request: dict[str, Any]) -> None:
    bench.fill()
    response = bench.run(bench.client.request(**request))
    assert response.status_code < 500, (request, response.text)
    if response.status_code >= 400:
        assert response.headers["content-type"] == "application/problem+json"
        assert json.loads(response.text)["status"] == response.status_code
