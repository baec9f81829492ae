"""The baselines that the method is compared with.

They find the target in D2's image by its appearance, without geometry.
"""
