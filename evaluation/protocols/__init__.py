"""What is measured, against what, with which constants. Every result file names its protocol and all parameters."""

from activestructure_gym.evaluation.protocols.standard import StandardProtocol, Truth

__all__ = ["StandardProtocol", "Truth"]
