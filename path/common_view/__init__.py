"""Where another drone's camera is, from what both cameras see of one place: without a marker.

For use on its own: ``from path.common_view.estimate import common_view`` (docs/common-view.md).
"""
