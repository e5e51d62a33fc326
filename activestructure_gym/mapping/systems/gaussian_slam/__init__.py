"""Gaussian-SLAM on given poses."""
