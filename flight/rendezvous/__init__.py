"""The receiver's way to the sender: where it must be, how it goes there, and the marker it goes
by.
"""
