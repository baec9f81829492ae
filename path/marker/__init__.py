"""The way from pixels of fiducial markers to the pose of frame ``v`` in a camera, with an honest
covariance.

For use on its own: ``from path.marker.locate import locate_marker`` (docs/marker.md). Nothing is
imported here, since rigs are decoded with ``path.marker.layout`` alone.
"""
