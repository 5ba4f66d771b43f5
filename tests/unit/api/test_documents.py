"""The documents in openapi/. Oracles: what the code writes now; references that lead somewhere."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from plumbline.api.documents import asyncapi, openapi, texts

FOLDER = Path(__file__).resolve().parents[3] / "openapi"


@pytest.mark.parametrize("name", ["openapi.json", "asyncapi.yaml"])
def test_the_files_are_what_the_code_writes(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == texts()[name], "run: python -m plumbline.api.documents"


def references(value: Any) -> list[str]:
    """Every $ref in a document."""
    if isinstance(value, dict):
        own = [value["$ref"]] if isinstance(value.get("$ref"), str) else []
        return own + [found for part in value.values() for found in references(part)]
    return [found for part in value for found in references(part)] if isinstance(value, list) else []


@pytest.mark.parametrize("document", [openapi(), asyncapi()], ids=["openapi", "asyncapi"])
def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    found = references(document)
    assert len(found) > 20
    for reference in found:
        target: Any = document
        for part in reference.removeprefix("#/").split("/"):
            target = target[part]
        assert target


def test_every_operation_answers_in_a_described_form_and_errors_are_problems() -> None:
    document = json.loads(json.dumps(openapi()))
    assert document["openapi"].startswith("3.")
    assert {"/v1/stations", "/v1/stations/{station}/motion", "/v1/alerts/{alert_id}/acknowledge"} <= set(
        document["paths"]
    )
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            assert operation["summary"], (method, path)
            for status, response in operation["responses"].items():
                if path.startswith("/v1/") and int(status) >= 400:
                    assert set(response["content"]) == {"application/problem+json"}, (method, path, status)


def test_asyncapi_is_yaml_with_examples_of_every_message() -> None:
    document = yaml.safe_load(texts()["asyncapi.yaml"])
    assert document["asyncapi"] == "3.0.0"
    for name, message in document["components"]["messages"].items():
        assert message["payload"]["$ref"].rsplit("/", 1)[1] == name
        if name != "Subscribe":
            schema = document["components"]["schemas"][name]
            (example,) = message["examples"]
            assert set(schema["required"]) <= set(example["payload"])
            assert set(example["payload"]) <= set(schema["properties"])
