"""The shaking table of Dai 2024, rebuilt from its numbers: three antennas and an IMU on a platform that is shaken.

Three receivers and a base station at 20 Hz on one frequency, an IMU at 200 Hz, as RTCM3 streams, and the truth that a
laser would have measured. What the paper states is taken from it (:mod:`experiment` names what it leaves open); what
differs between seeds is noise, the surroundings' reflections, ambiguities, clocks and the IMU's errors.
"""
