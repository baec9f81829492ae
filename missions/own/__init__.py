"""Missions of a person's own (docs/own-missions.md): ``from missions.own import Drone``, one coroutine a drone."""

from missions.own.drone import Drone

__all__ = ["Drone"]
