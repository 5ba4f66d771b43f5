"""Write the API's documents: ``python -m plumbline.api.documents [DIRECTORY]`` (default ``openapi``).

openapi.json describes REST, asyncapi.yaml the WebSocket. Both come from the code; a test compares them with the files.
"""

import argparse
import inspect
import json
import re
from pathlib import Path
from typing import Any, Final

import yaml  # type: ignore[import-untyped]
from pydantic import BaseModel, Field, TypeAdapter

from plumbline import __version__
from plumbline.api import quality_schemas, schemas, stream
from plumbline.api.application import routes
from plumbline.api.feed import Channel
from plumbline.records import Status

_REFERENCE: Final = "#/components/schemas/{model}"


class _Numbered(BaseModel):
    sequence: int = Field(description="one more at every output of the feed; gaps are what was not subscribed to")


class SolutionMessage(_Numbered, schemas.SolutionOut):
    """A solution."""

    type: str = "solution"


class MotionMessage(_Numbered):
    """A block of motion, sample k at `time` + k × `interval_s`. A higher revision of a block replaces the lower."""

    type: str = "motion"
    station: str
    time: schemas.IsoTime
    interval_s: float
    status: Status
    reason: str
    revision: int
    east_mm: schemas.Column
    north_mm: schemas.Column
    up_mm: schemas.Column
    velocity_east_mm_s: schemas.Column
    velocity_north_mm_s: schemas.Column
    velocity_up_mm_s: schemas.Column
    acceleration_east_mm_s2: schemas.Column
    acceleration_north_mm_s2: schemas.Column
    acceleration_up_mm_s2: schemas.Column
    sigma_east_mm: schemas.Column
    sigma_north_mm: schemas.Column
    sigma_up_mm: schemas.Column
    roll_deg: schemas.Column | None = None
    pitch_deg: schemas.Column | None = None
    heading_deg: schemas.Column | None = None
    sigma_roll_deg: schemas.Column | None = None
    sigma_pitch_deg: schemas.Column | None = None
    sigma_heading_deg: schemas.Column | None = None


class StatusMessage(_Numbered, schemas.StatusOut):
    """A station's status."""

    type: str = "status"


class AlertMessage(_Numbered, schemas.AlertEventOut):
    """An alert became active or was cleared."""

    type: str = "alert"


class QualityMessage(_Numbered, quality_schemas.QualityOut):
    """What an epoch's solution is worth."""

    type: str = "quality"


class AttitudeMessage(_Numbered):
    """A platform's attitude at one instant."""

    type: str = "attitude"
    station: str
    time: schemas.IsoTime
    status: Status
    roll_deg: float | None
    pitch_deg: float | None
    heading_deg: float | None
    sigma_roll_deg: float | None
    sigma_pitch_deg: float | None
    sigma_heading_deg: float | None


class HelloMessage(BaseModel):
    """The first message of a connection."""

    type: str = "hello"
    feed: str
    next_sequence: int
    oldest_sequence: int


class SubscribedMessage(BaseModel):
    """The subscription is in force."""

    type: str = "subscribed"
    stations: list[str] | None
    channels: list[Channel] | None
    next_sequence: int


class MissedMessage(BaseModel):
    """What lies between these numbers was not sent: the client was too slow or too long away."""

    type: str = "missed"
    first_sequence: int
    last_sequence: int
    count: int | None


class ErrorMessage(BaseModel):
    """The client's message was not understood."""

    type: str = "error"
    detail: str


SENT: Final = (
    HelloMessage,
    SubscribedMessage,
    SolutionMessage,
    MotionMessage,
    StatusMessage,
    AlertMessage,
    QualityMessage,
    AttitudeMessage,
    MissedMessage,
    ErrorMessage,
)


def stream_examples() -> dict[str, dict[str, Any]]:
    """The JSON examples in the documentation of :mod:`plumbline.api.stream`, by their type."""
    text = inspect.getdoc(stream) or ""
    examples = [json.loads(block) for block in re.findall(r"^    (\{\"type\".*?\})$(?=\n\n|\Z)", text, re.M | re.S)]
    return {example["type"]: example for example in examples}


def _prose() -> str:
    """The stream's documentation without its examples, which stand at the messages."""
    paragraphs = (inspect.getdoc(stream) or "").split("\n\n")
    return "\n\n".join(p for p in paragraphs if not p.startswith('    {"type"')) + "\n"


def openapi() -> dict[str, Any]:
    """The OpenAPI document."""
    return routes().openapi()


def asyncapi() -> dict[str, Any]:
    """The AsyncAPI document of the stream."""
    examples = stream_examples()
    all_schemas: dict[str, Any] = {}
    for model in (stream.Subscribe, *SENT):
        schema = TypeAdapter(model).json_schema(ref_template=_REFERENCE, mode="serialization")
        all_schemas.update(schema.pop("$defs", {}))
        all_schemas[model.__name__] = schema
    messages = {
        model.__name__: {
            "summary": inspect.getdoc(model),
            "payload": {"$ref": _REFERENCE.format(model=model.__name__)},
            "examples": [{"payload": examples[model.model_fields["type"].default]}],
        }
        for model in SENT
    }
    messages["Subscribe"] = {
        "summary": inspect.getdoc(stream.Subscribe),
        "payload": {"$ref": _REFERENCE.format(model="Subscribe")},
    }
    on_channel = {name: {"$ref": f"#/components/messages/{name}"} for name in messages}
    return {
        "asyncapi": "3.0.0",
        "info": {"title": "plumbline stream", "version": __version__, "description": _prose()},
        "channels": {"stream": {"address": "/v1/stream", "messages": on_channel}},
        "operations": {
            "receive": _operation("send", *(model.__name__ for model in SENT)),
            "subscribe": _operation("receive", "Subscribe"),
        },
        "components": {"messages": messages, "schemas": dict(sorted(all_schemas.items()))},
    }


def _operation(action: str, *names: str) -> dict[str, Any]:
    messages = [{"$ref": f"#/channels/stream/messages/{name}"} for name in names]
    return {"action": action, "channel": {"$ref": "#/channels/stream"}, "messages": messages}


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """YAML with texts of several lines as such."""


def _text(dumper: Any, text: str) -> Any:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _text)


def texts() -> dict[str, str]:
    """File name → content."""
    return {
        "openapi.json": json.dumps(openapi(), indent=2, ensure_ascii=False) + "\n",
        "asyncapi.yaml": yaml.dump(asyncapi(), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120),
    }


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("directory", type=Path, nargs="?", default=Path("openapi"))
    directory: Path = parser.parse_args().directory
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in texts().items():
        (directory / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
