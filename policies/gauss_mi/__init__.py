"""Provide GauSS-MI ([gauss_mi]): score views by the reliability of the Gaussians from their side."""

from activestructure_gym.policies.gauss_mi.policy import GaussMI as GaussMI
from activestructure_gym.policies.gauss_mi.policy import GaussMICov as GaussMICov
