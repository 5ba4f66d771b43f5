"""`plumbline serve`: the roles, put together into processes.

serve          the roles of this process on one event loop, from start to an orderly end
ingest_role    listener, NTRIP clients, archive; publishes what is archived and answers for it
store_role     results from the bus into the database; answers for stations and checkpoints
api_role       REST, WebSocket, dashboard
worker_pool    worker processes, kept running
"""

from plumbline.app.serve import ROLES, Server, main

__all__ = ["ROLES", "Server", "main"]
