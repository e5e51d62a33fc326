"""Provide Co-SLAM with given poses."""
