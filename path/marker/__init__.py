"""From pixels of fiducial markers to the pose of frame ``v`` in a camera, with an honest covariance."""
