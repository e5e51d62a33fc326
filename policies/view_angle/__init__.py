"""Provide COVER ([cover]): choose the view from the directions least similar to those seen so far."""

from activestructure_gym.policies.view_angle.policy import ViewAngle as ViewAngle
