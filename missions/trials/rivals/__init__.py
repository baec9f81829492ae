"""Look-alikes: PATH, ORB and XFeat on the same frames."""
