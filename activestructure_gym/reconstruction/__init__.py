"""Run episodes of active reconstruction without Gymnasium: capture, map, offer candidate views, move."""

from activestructure_gym.reconstruction.episode import Reconstruction, StepResult

__all__ = ["Reconstruction", "StepResult"]
