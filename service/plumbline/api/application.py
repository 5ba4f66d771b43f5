"""The application: routes, error forms, metrics and the dashboard, put together."""

from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI
from fastapi.middleware.gzip import GZipMiddleware
from fastapi.openapi.utils import get_openapi
from fastapi.responses import PlainTextResponse
from fastapi.staticfiles import StaticFiles
from prometheus_client import CollectorRegistry

from plumbline import __version__
from plumbline.api import alerts, devices, operations, problems, quality, series, stations, stream, thresholds, units
from plumbline.api.control import Control
from plumbline.api.feed import Feed
from plumbline.api.problems import Problem
from plumbline.config import ServerSettings
from plumbline.store import Store

DASHBOARD: Final = Path(__file__).with_name("dashboard")
_DESCRIPTION: Final = (
    "Watches structures and slopes move. Lengths in millimetres, angles in degrees, times in ISO 8601 UTC; errors are "
    "problem documents (RFC 9457); lists come in parts. The live stream, `/v1/stream`, is described in asyncapi.yaml."
)


def create_app(
    store: Store,
    feed: Feed,
    control: Control,
    settings: ServerSettings,
    registry: CollectorRegistry | None = None,
    dashboard: Path = DASHBOARD,
) -> FastAPI:
    """The ASGI application; ``registry`` may carry the caller's own metrics, which ``/metrics`` then shows too."""
    units.warm_up()
    app = routes()
    app.state.store, app.state.feed, app.state.control, app.state.settings = store, feed, control, settings
    app.state.meters = operations.Meters(registry if registry is not None else CollectorRegistry(), feed)
    _mount_dashboard(app, dashboard)
    return app


def routes() -> FastAPI:
    """All routes without the parts behind them: enough for the documents."""
    app = FastAPI(title="plumbline", version=__version__, description=_DESCRIPTION, redirect_slashes=False)
    problems.install(app)
    for module in (stations, series, quality, thresholds, alerts, devices, operations, stream):
        app.include_router(module.router)
    app.add_middleware(problems.BodyLimit)
    app.add_middleware(GZipMiddleware, minimum_size=2000, compresslevel=1)
    app.add_middleware(operations.Measured, owner=app)
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


def _openapi(app: FastAPI) -> dict[str, Any]:
    """The OpenAPI document, with problem documents where FastAPI would describe its own form of errors."""
    if app.openapi_schema is None:
        document = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes, tags=app.openapi_tags
        )
        schemas = document["components"]["schemas"]
        for name in ("HTTPValidationError", "ValidationError"):
            schemas.pop(name, None)
        problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas.update(problem.pop("$defs", {}))
        schemas["Problem"] = problem
        app.openapi_schema = document
    return app.openapi_schema


def _mount_dashboard(app: FastAPI, dashboard: Path) -> None:
    if (dashboard / "index.html").is_file():
        app.mount("/", StaticFiles(directory=dashboard, html=True), name="dashboard")
        return

    @app.get("/", include_in_schema=False)
    def no_dashboard() -> PlainTextResponse:
        return PlainTextResponse(
            "plumbline is running. Its dashboard is not built: run `make install`. The API: /openapi.json\n"
        )
