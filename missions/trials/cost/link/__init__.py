"""Bytes of every packet."""
