"""Markers of a layout anywhere in an image, at the cost of some passes over its pixels.

A printed marker is dark, its border is light. So whatever is darker than its surroundings is
gathered into components; those whose outline is a quadrilateral get their sides from the image's
gradient, and their cells are correlated with the prints that are looked for. Nothing here decodes:
a rig knows its markers, and what is not one of them is nothing.
"""
