"""Drivers: one file per part of the real world, behind the Protocols in ``drivers.interfaces``."""
