"""Bytes on the socket."""
