"""Errors as RFC 9457 problem documents, all of them; and what is refused before a handler sees it."""

import math
from collections.abc import Iterable, Mapping
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import quote

from fastapi import FastAPI, HTTPException, Request
from fastapi.encoders import jsonable_encoder
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException as StarletteHTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from plumbline.errors import StoreError

MEDIA_TYPE: Final = "application/problem+json"
MAX_BODY_BYTES: Final = 1_048_576
MAX_JSON_DEPTH: Final = 32


class ErrorItem(BaseModel):
    """One thing that is wrong with a request."""

    where: str = Field(
        description="query, path, header or body, and the names down to the value", examples=["body.level"]
    )
    detail: str


class Problem(BaseModel):
    """RFC 9457."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str = ""
    instance: str = ""
    errors: list[ErrorItem] = []


def problem(
    request: Request, status: int, detail: str = "", errors: Iterable[ErrorItem] = (), headers: Any = None
) -> JSONResponse:
    """The response that says what went wrong."""
    body = Problem(
        title=HTTPStatus(status).phrase,
        status=status,
        detail=detail,
        instance=quote(request.scope["path"]),
        errors=list(errors),
    )
    return JSONResponse(body.model_dump(), status, headers, MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Make every error of an application a problem document."""
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(StarletteHTTPException, _http)
    app.add_exception_handler(StoreError, _store)
    app.add_exception_handler(Exception, _unexpected)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    items = [
        ErrorItem(where=".".join(str(part) for part in item["loc"]), detail=item["msg"]) for item in error.errors()[:20]
    ]
    detail = "; ".join(f"{item.where}: {item.detail}" for item in items[:3])
    return problem(request, 422, _printable(detail), [ErrorItem(**_printable_item(item)) for item in items])


def _printable_item(item: ErrorItem) -> dict[str, str]:
    return {"where": _printable(item.where), "detail": _printable(item.detail)}


def _printable(text: str) -> str:
    """Text that any JSON encoder can carry: what came in may hold lone surrogates."""
    return text.encode("utf-8", "replace").decode("utf-8")


async def _http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, StarletteHTTPException)
    phrase = HTTPStatus(error.status_code).phrase
    detail = error.detail if isinstance(error.detail, str) else str(jsonable_encoder(error.detail))
    return problem(request, error.status_code, "" if detail == phrase else _printable(detail), headers=error.headers)


async def _store(request: Request, error: Exception) -> JSONResponse:
    return problem(request, 503, "the database cannot be reached at the moment", headers={"Retry-After": "5"})


async def _unexpected(request: Request, error: Exception) -> JSONResponse:
    return problem(request, 500, "an error of the server's own; its log says more")


def not_found(what: str, name: str) -> HTTPException:
    """404 for a thing of a name."""
    return HTTPException(404, f"there is no {what} {name!r}")


# --------------------------------------------------------------------------------------------- refused at the door


def refuse_unknown_query(request: Request) -> None:
    """Refuse query parameters that the route does not have, and those given twice that it takes once."""
    known = _query_parameters(request.app, request.scope["route"].path_format, request.method)
    for name in request.query_params:
        if name not in known:
            names = ", ".join(sorted(known)) or "none"
            raise HTTPException(422, f"unknown query parameter {name!r}; this address takes: {names}")
        if len(request.query_params.getlist(name)) > 1:
            raise HTTPException(422, f"query parameter {name!r} is given more than once")


def _query_parameters(app: FastAPI, path: str, method: str) -> frozenset[str]:
    operation: Mapping[str, Any] = app.openapi()["paths"].get(path, {}).get(method.lower(), {})
    return frozenset(p["name"] for p in operation.get("parameters", ()) if p["in"] == "query")


async def refuse_odd_json(request: Request) -> None:
    """Refuse what JSON bodies may hold and no database or other JSON reader takes: NaN, NUL, lone surrogates."""
    if request.method not in ("POST", "PATCH", "PUT"):
        return
    try:
        body = await request.json()
    except (ValueError, RecursionError):
        return  # no JSON: the route says so itself
    complaint = odd_json(body)
    if complaint:
        raise HTTPException(422, f"body: {complaint}")


def odd_json(value: object, depth: int = 0) -> str:
    """What is odd about a JSON value; empty when nothing is."""
    if depth > MAX_JSON_DEPTH:
        return "nested too deeply"
    if isinstance(value, str):
        return _odd_text(value)
    if isinstance(value, float):
        return "" if math.isfinite(value) else "numbers must be finite"
    if isinstance(value, int):
        return "" if abs(value) < 2**63 else "an integer that is too large"
    parts: Iterable[object] = ()
    if isinstance(value, Mapping):
        parts = (*value.keys(), *value.values())
    elif isinstance(value, list):
        parts = value
    return next((found for part in parts if (found := odd_json(part, depth + 1))), "")


def _odd_text(text: str) -> str:
    if "\x00" in text:
        return "text may not hold the character NUL"
    return "text may not hold half of a surrogate pair" if any("\ud800" <= c <= "\udfff" for c in text) else ""


class BodyLimit:
    """ASGI middleware: a request's body may not be longer than ``MAX_BODY_BYTES``."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the body as it comes in."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        total = 0

        async def counted() -> Message:
            nonlocal total
            message = await receive()
            total += len(message.get("body", b""))
            if total > MAX_BODY_BYTES:
                raise HTTPException(413, f"the body is longer than {MAX_BODY_BYTES} bytes")
            return message

        return await self._app(scope, counted, send)
