"""Reimplement published mapping systems with given poses. Each package has a ``config.py`` and a ``mapper.py``."""
