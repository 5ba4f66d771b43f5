"""The application: routes, error forms, metrics and the dashboard, put together."""

from fastapi import FastAPI
from prometheus_client import CollectorRegistry

from plumbline.api.control import Control
from plumbline.api.feed import Feed
from plumbline.config import ServerSettings
from plumbline.store import Store


def create_app(
    store: Store, feed: Feed, control: Control, settings: ServerSettings, registry: CollectorRegistry | None = None
) -> FastAPI:
    """The ASGI application; ``registry`` may carry the caller's own metrics, which ``/metrics`` then shows too."""
    app = FastAPI(title="plumbline")
    app.state.store, app.state.feed, app.state.control, app.state.settings = store, feed, control, settings
    app.state.registry = registry
    return app
