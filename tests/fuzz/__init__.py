"""Fuzzers: damaged and hostile input of every kind must be used or refused in one sentence.

    python -m tests.fuzz --cases 1000            # every kind
    python -m tests.fuzz --kind scenes --only 17 # one case again, its files kept

A kind is a module of this package with ``case(rng, folder)``, which writes an input under ``folder`` and returns what
reads it, and ``CI_CASES``, how many of them pytest runs. Modules whose name begins with an underscore are helpers.

Cases are structured files (a glTF whose accessors disagree, a COLLADA whose nodes double) made from one seeded
generator, in a process that is watched from outside. hypothesis would bring shrinking, but neither limits memory nor
survives a crash or a hang of the code under test, and a case here is already one change to one small file; atheris
instruments Python, while most of the work of these readers is done in NumPy, Pillow and expat.
"""
