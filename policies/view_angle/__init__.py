"""COVER ([cover]): the view from the newest side."""

from activestructure_gym.policies.view_angle.policy import ViewAngle as ViewAngle
