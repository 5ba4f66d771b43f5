"""Stations whose truth is known: constellation, corrections, motion, errors and sensors, and the bytes they send.

The physics between satellite and receiver is the server's own (:mod:`plumbline.gnss`): what is simulated is what
differs in the field, noise, multipath, the atmosphere's departures, clocks, slips and losses. Everything follows from
seeds and times: the same plan gives the same bytes.
"""
