"""Readers of the files that geodesists and seismologists exchange: path in, records out, plain or compressed.

    rinex_observation  RINEX 2.11, 3 observations → Epoch, streaming      rinex_navigation  RINEX 3, 4 → ephemerides
    sp3                SP3 → PreciseOrbits (and its clocks)               rinex_clock       RINEX clock → PreciseClocks
    antex              ANTEX → AntennaCalibration                         blq               ocean loading coefficients
    seismic            SAC, MiniSEED, CSV → Series

A file that is not what it should be raises :class:`plumbline.errors.FileFormatError`, naming the file and the line; a
damaged record within a good file is skipped and counted.
"""
