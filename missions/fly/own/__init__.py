"""Missions of a person's own, one coroutine a drone; what they may use is in ``missions.own``."""

from missions.fly.own.drone import Drone

__all__ = ["Drone"]
