"""Reimplement published mapping systems with given poses, one folder each: ``config.py`` and ``mapper.py``."""
