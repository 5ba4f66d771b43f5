"""The server's face: REST, WebSocket, metrics and the built dashboard. Schemas, degrees, millimetres and UTC live here.

create_app(store, feed, control, settings) -> FastAPI     the whole application
Feed            `feed.publish(output)` hands a record to every WebSocket subscriber
Control         the callbacks that the composition root gives
"""

from plumbline.api.application import create_app
from plumbline.api.control import Control, NoControl
from plumbline.api.feed import Feed

__all__ = ["Control", "Feed", "NoControl", "create_app"]
