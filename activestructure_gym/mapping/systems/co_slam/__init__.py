"""Provide the mapper of Co-SLAM with given poses."""
