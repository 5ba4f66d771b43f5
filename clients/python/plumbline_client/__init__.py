"""Client of a plumbline server: stations, series and alerts over REST, and the live stream over a WebSocket.

    with Client("http://localhost:8000") as client:
        for station in client.stations():
            print(station["station"], station["status"]["state"])
        motion = client.motion("bridge", start=datetime(2026, 1, 1, tzinfo=UTC), max_points=5000)
        plot(motion["time"], motion["east_mm"])

    async with AsyncClient("http://localhost:8000") as client:
        async for message in client.stream(stations=["bridge"], channels=["motion"]):
            print(message["time"], message["east_mm"][-1])

Answers are plain dictionaries, as the server's OpenAPI document describes them: millimetres, degrees, UTC. Series come
as dictionaries of NumPy arrays: times ``datetime64[ns]``, numbers ``float64`` with NaN for what is missing.
"""

from plumbline_client.asynchronous import AsyncClient
from plumbline_client.errors import PlumblineError
from plumbline_client.synchronous import Client

__all__ = ["AsyncClient", "Client", "PlumblineError"]
