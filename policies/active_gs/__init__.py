"""Provide ActiveGS ([active_gs]): score unexplored space and uncertain surface, minus path length."""

from activestructure_gym.policies.active_gs.policy import ActiveGS as ActiveGS
