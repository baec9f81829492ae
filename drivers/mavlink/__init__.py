"""PX4 and ArduPilot: the vehicle behind MAVSDK, its telemetry, modes and parameters, and its
guard's own link.
"""
