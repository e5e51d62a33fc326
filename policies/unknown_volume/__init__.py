"""Provide a policy that explores by volume: it scores the unknown space that the path to a view would reveal."""

from activestructure_gym.policies.unknown_volume.policy import UnknownVolume as UnknownVolume
