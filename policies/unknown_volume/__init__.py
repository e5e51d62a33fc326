"""The unknown space that the way to a view opens, as the only score: exploration without map or planes."""

from activestructure_gym.policies.unknown_volume.policy import UnknownVolume as UnknownVolume
