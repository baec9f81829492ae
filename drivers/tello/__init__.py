"""DJI Tello: the vehicle and its camera behind djitellopy."""
