"""RT-GuIDE ([rt_guide]): first the region that is worth its way, then the view in it where most still moves."""

from activestructure_gym.policies.rt_guide.policy import RTGuide as RTGuide
