"""Physics of satellites, atmosphere, antennas and the Earth: functions and Numba kernels, no state.

An epoch costs three calls: states at transmission (:mod:`plumbline.gnss.satellite_states`), Sun and Moon
(:mod:`plumbline.gnss.sun_moon`) and the model of all lines of sight (:mod:`plumbline.gnss.line_of_sight`);
troposphere site, tides (:mod:`plumbline.gnss.tides`) and antenna book change slowly and are kept by the caller.

A kernel's compiled form is cached by its own file's time stamp only: after a change to a kernel that others call,
remove this package's ``__pycache__``.
"""
