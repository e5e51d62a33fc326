"""Provide the mapper of MonoGS with given poses."""
