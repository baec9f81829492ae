"""Intel RealSense D400 cameras: colour with depth registered to it."""
