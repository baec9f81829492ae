"""Processor time by stage, and against ORB and XFeat."""
