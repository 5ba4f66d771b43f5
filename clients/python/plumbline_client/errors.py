"""What a server refuses, as an exception."""

from typing import Any

import httpx


class PlumblineError(Exception):
    """The server answered with a problem document (RFC 9457)."""

    def __init__(self, status: int, title: str, detail: str, errors: list[dict[str, Any]]) -> None:
        super().__init__(f"{status} {title}" + (f": {detail}" if detail else ""))
        self.status = status
        self.title = title
        self.detail = detail
        self.errors = errors


def checked(response: httpx.Response) -> httpx.Response:
    """The response, when it is a success; else raises :class:`PlumblineError`."""
    if response.is_success:
        return response
    try:
        body = response.json()
    except ValueError:
        body = {}
    if not isinstance(body, dict):
        body = {}
    title = str(body.get("title") or response.reason_phrase)
    raise PlumblineError(response.status_code, title, str(body.get("detail", "")), list(body.get("errors", [])))
