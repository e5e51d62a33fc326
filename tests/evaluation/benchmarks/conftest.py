"""The scenes with known answers of the sensors' tests."""

from tests.sensors.conftest import box_room  # noqa: F401
