"""ActiveGS ([active_gs]): unexplored space and unsure surface, less the share of the way."""

from activestructure_gym.policies.active_gs.policy import ActiveGS as ActiveGS
