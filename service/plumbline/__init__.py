"""plumbline: watches structures and slopes move.

The flow, top to bottom (each stage a package of its name)::

    DTU ──TCP──► ingest ──► archive (bytes on disk, first)
                   │
                   ▼ bus          raw/{station}
                 worker: rtcm3 ► epochs ► positioning ► fusion ► quality ► alerts      (one `pipeline` a station)
                   │
                   ▼ bus          solution | motion | alert | status /{station}
                 store ─► SQL                 api ─► REST, WebSocket, dashboard

Frames and units stand in names: ``_ecef_m`` Earth-fixed metres (the corrections' ITRF), ``_enu_m`` east, north, up
metres at the station's reference position, ``_m_s``, ``_m_s2``, ``_rad``, ``_hz``, ``_cycles``; ``_gps_ns`` GPS time in
integer nanoseconds since 1980-01-06; ``rotation_a_from_b`` turns b's coordinates into a's. SI and radians inside;
degrees, millimetres and UTC only at the API.

Suffix legend of the estimation code: ``x`` state, ``p`` its covariance, ``h`` design matrix, ``r`` measurement
covariance, ``v`` innovation, ``s`` innovation covariance.
"""

__version__ = "0.1.0"
