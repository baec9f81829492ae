"""The calibrated camera: from points to pixels and back."""
