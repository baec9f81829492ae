"""The surface that missions of one's own are written on (docs/own-missions.md): ``from missions.own
import Drone``.
"""

from missions.fly.own import Drone

__all__ = ["Drone"]
