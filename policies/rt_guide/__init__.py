"""Provide RT-GuIDE ([rt_guide]): choose a region by uncertainty and path length, then a view of moving Gaussians."""

from activestructure_gym.policies.rt_guide.policy import RTGuide as RTGuide
