"""What a drone believes of all objects that it sees: where each is, whether it exists, and which
was designated.
"""
