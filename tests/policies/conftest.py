"""Fixtures that planners' tests share."""

from tests.two_walls import frame_of, hand_made, looks, two_walls  # noqa: F401
