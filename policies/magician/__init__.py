"""Provide MAGICIAN ([magician]): plan several views over imagined surface by a beam search."""

from activestructure_gym.policies.magician.policy import Magician as Magician
