"""Flying a rig in a simulated world, in virtual time or in real time: programs started, told
faults, ended.
"""
