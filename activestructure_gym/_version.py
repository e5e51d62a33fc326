"""Hold the version in one place: setup.cfg and every result file read it here."""

__version__ = "0.1.0"
