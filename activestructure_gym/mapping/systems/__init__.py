"""Published mapping systems on given poses, a folder each: constants in ``config.py``, mapper in ``mapper.py``."""
