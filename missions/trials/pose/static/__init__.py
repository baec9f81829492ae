"""D2's and the target's position from one frame."""
