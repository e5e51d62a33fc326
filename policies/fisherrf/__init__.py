"""Provide FisherRF ([fisherrf]): score views by Fisher information."""

from activestructure_gym.policies.fisherrf.policy import FisherRF as FisherRF
from activestructure_gym.policies.fisherrf.policy import FisherRFCov as FisherRFCov
from activestructure_gym.policies.fisherrf.policy import FisherRFPath as FisherRFPath
