"""`plumbline serve`: the roles, put together into processes.

serve          the roles of this process on one event loop, from start to an orderly end
ingest_role    listener, NTRIP clients, archive; answers for what is archived
archive_writer received bytes into the archive, through times in which its disk refuses
publisher      what ingest puts on the bus, and word of what the bus refused
store_role     results from the bus into the database; answers for stations and checkpoints
api_role       REST, WebSocket, dashboard
worker_pool    worker processes, kept running
"""

from plumbline.app.serve import ROLES, Server, main

__all__ = ["ROLES", "Server", "main"]
