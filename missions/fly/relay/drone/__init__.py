"""One drone's life in a relay or a team: its parts, its roles one after the other, its battery and
its ways.
"""
