"""Provide Gaussian-SLAM with given poses."""
