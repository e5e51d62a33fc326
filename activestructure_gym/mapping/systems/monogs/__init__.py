"""Provide MonoGS with given poses."""
