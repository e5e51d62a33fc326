"""What the warm-up says about its compiling."""

import subprocess
import sys

from activestructure_gym.compiling import EPISODE_KERNELS
from activestructure_gym.evaluation.warmup import _listen, _Tally


def test_a_kernel_counts_once_whoever_compiles_it():
    said = []
    tally = _Tally(said.append)
    for name in ("room.one", "room.two", "room.one"):
        tally(name)
    counts = [line.rpartition(",")[0] for line in said]
    start = "compiling kernels, once per installation: "
    assert counts == [f"{start}{number} of about {EPISODE_KERNELS}" for number in (1, 2, 2)]


def test_only_marked_lines_of_a_process_are_kernels():
    code = "print('compiling room.one'); print('policy speaks'); print(); print('compiling room.two')"
    heard = []
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        _listen(process, heard.append)
    assert heard == ["room.one", "room.two"]
