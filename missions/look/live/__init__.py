"""A flight as it goes, for viewers: its logs are followed as they are written, and served by a
process of its own.
"""
