"""Bytes from devices and casters: who they are from, and nothing of what they mean.

IngestServer     the asyncio listener; ``sink(station, data)`` gets what devices send
NtripClient      fetches a caster's stream into the same sink
Directory        which first bytes stand for which station
registration     the first bytes of a connection, sans-IO
stream_split     prefixes, heartbeats and several stations on a connection, sans-IO
http_chunked     chunked transfer coding, sans-IO
callers          unknown devices: listed, slowed down, adoptable
ReceiveClock     strictly increasing receive times
"""

from plumbline.ingest.callers import Caller, Callers
from plumbline.ingest.clock import ReceiveClock
from plumbline.ingest.directory import Directory
from plumbline.ingest.ntrip_client import NtripClient
from plumbline.ingest.server import ConnectionEvent, IngestServer

__all__ = ["Caller", "Callers", "ConnectionEvent", "Directory", "IngestServer", "NtripClient", "ReceiveClock"]
