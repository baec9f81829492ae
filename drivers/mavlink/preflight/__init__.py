"""The things that an autopilot must have before it is flown: parameters, pilot's radio and
fence.
"""
