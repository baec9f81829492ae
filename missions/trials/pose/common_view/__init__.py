"""The trial of relative poses without the marker, on real pairs of RGB-D frames."""
