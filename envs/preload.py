"""Load everything that an environment needs, so that worker processes forked from this one begin at once.

``multiprocessing.set_forkserver_preload(["activestructure_gym.envs.preload"])`` makes Python's forkserver import it.
Kernels are loaded but not run, since threads do not survive a fork. Workers compile those that are not on disk yet.
"""

from __future__ import annotations

from activestructure_gym.compiling.ahead import listed_kernels
from activestructure_gym.config import configure
from activestructure_gym.envs import tasks as tasks

configure("rl")  # imports the modules of all features
for _kernel in listed_kernels(
    ("activestructure_gym.features.unknown_volume", "activestructure_gym.features.hole_area")
):
    if _kernel.is_kept():
        _kernel.compile()
