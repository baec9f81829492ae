"""Detectors of targets: colour, ONNX networks, and trackers between detections."""
