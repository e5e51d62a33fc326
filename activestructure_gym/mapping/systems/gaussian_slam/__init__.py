"""Provide the mapper of Gaussian-SLAM with given poses."""
