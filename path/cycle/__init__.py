"""One cycle of each drone: D1 judges what D2 found where D1's word and D2's own pose say the target
is.
"""
