"""The PATH method: perspective alignment and tracking handoff between two drones.

Pure functions and values only: no I/O, clocks, threads or asyncio. Same inputs, same outputs.
Frames and units follow one convention everywhere: ``T_a_b`` maps coordinates in ``b`` to ``a``;
``v`` is the marker frame, ``c1``/``c2`` the cameras (x right, y down, z forward), ``b1``/``b2`` the
bodies (FRD), ``n`` local NED, ``w`` the simulated world (ENU). SI units; time stamps are integer
nanoseconds.
"""
