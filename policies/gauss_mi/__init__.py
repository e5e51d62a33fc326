"""GauSS-MI as a policy ([gauss_mi])."""

from activestructure_gym.policies.gauss_mi.policy import GaussMI as GaussMI
from activestructure_gym.policies.gauss_mi.policy import GaussMICov as GaussMICov
