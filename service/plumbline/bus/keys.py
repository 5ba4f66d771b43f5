"""Every key expression of the bus. ``{station}`` is a station's id; ``**`` in a subscription means all."""

RAW = "plumbline/raw"  # chunks as archived, by station
CLOCK = "plumbline/clock"  # ticks of every ingest
SOLUTION = "plumbline/solution"
MOTION = "plumbline/motion"
ALERT = "plumbline/alert"
STATUS = "plumbline/status"
QUALITY = "plumbline/quality"
CHECKPOINT = "plumbline/checkpoint"
REWIND = "plumbline/rewind"  # the store asks for a station to be computed again from its last stored checkpoint
SETTINGS = "plumbline/settings"  # a station's settings or thresholds have changed
CONNECTION = "plumbline/connection"  # connects and disconnects of a station's device
ALIVE_INGEST = "plumbline/alive/ingest"
ALIVE_WORKER = "plumbline/alive/worker"
ALIVE_STORE = "plumbline/alive/store"
QUERY_ARCHIVE = "plumbline/query/archive"  # /{archive}/{station}: chunks from a receive time on
QUERY_STATIONS = "plumbline/query/stations"  # the stations and thresholds in the database
QUERY_CHECKPOINT = "plumbline/query/checkpoint"  # /{station}: its last stored checkpoint
QUERY_DEVICES = "plumbline/query/devices"  # /{archive}: unknown devices and connected stations of an ingest
QUERY_REPORT = "plumbline/query/report"  # /{process}: counters, and what is failing

#: Key prefix of each kind of output, by its class name in :mod:`plumbline.records`.
OUTPUTS = {
    "Solution": SOLUTION,
    "Motion": MOTION,
    "AlertEvent": ALERT,
    "StationStatus": STATUS,
    "QualityReport": QUALITY,
}


def of(prefix: str, *parts: str) -> str:
    """A key below a prefix: ``of(RAW, "bridge-1")``."""
    return "/".join((prefix, *parts))


def last_part(key: str) -> str:
    """What stands after the last slash."""
    return key.rsplit("/", 1)[-1]
