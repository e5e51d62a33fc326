"""Provide COVER ([cover]): choose the view whose directions differ most from the directions seen so far."""

from activestructure_gym.policies.view_angle.policy import ViewAngle as ViewAngle
