"""HGS-Planner ([hgs_planner], by its text): local views by gain, then a tour through the parts that are not done."""

from activestructure_gym.policies.hgs_planner.policy import HGSPlanner as HGSPlanner
