"""From frames to observations: detections, markers and depth of one image, and the instants they belong to."""
