"""The list of kernels that the progress of a first comparison counts."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from activestructure_gym.compiling.files import package_folders
from activestructure_gym.evaluation.running import warmup
from activestructure_gym.evaluation.running.first_kernels import kernels_of, not_compiled
from activestructure_gym.features import FEATURES
from tests.parsed import dotted, nodes


def kernels_in_the_sources() -> set[str]:
    """Every function under the decorator, or given to it, by its full name."""
    found = set()
    for room in package_folders():
        package = "activestructure_gym" if room.name == "activestructure_gym" else f"activestructure_gym.{room.name}"
        for file in room.rglob("*.py"):
            if "kernel" not in file.read_text(encoding="utf-8"):
                continue
            module = ".".join([package, *file.relative_to(room).with_suffix("").parts])
            imported = {
                alias.name: node.module
                for node in nodes(file)
                if isinstance(node, ast.ImportFrom)
                for alias in node.names
            }
            for node in nodes(file):
                if isinstance(node, ast.FunctionDef) and any(dotted(d) == "kernel" for d in node.decorator_list):
                    found.add(f"{module}.{node.name}")
                if isinstance(node, ast.Call) and dotted(node.func) == "kernel":
                    name = ast.unparse(node.args[0])
                    found.add(f"{imported.get(name, module)}.{name}")
    return found


def test_every_kernel_of_the_list_is_in_the_sources_and_every_feature_s_own_is_counted():
    asked = kernels_of(list(FEATURES))
    known = kernels_in_the_sources()
    assert asked <= known, asked - known
    files = {FEATURES.get(name).__module__ for name in FEATURES}
    of_features = {name for name in known if name.rpartition(".")[0] in files}
    assert len(of_features) > 8 and of_features <= asked, of_features - asked


def test_a_feature_s_kernels_are_counted_where_it_is_asked_for():
    some, more = kernels_of(["pixel"]), kernels_of(["pixel", "unknown_volume_way"])
    assert more - some == {"activestructure_gym.features.unknown_volume._open"}
    assert len(some) > 100


@pytest.mark.parametrize("folder", ["splatting/__pycache__", "splatting_0123abcd"])
def test_what_is_compiled_already_is_not_counted(folder):
    names = {"activestructure_gym.splatting.kernels.score", "activestructure_gym.mapping.kernels.score"}
    files = [Path(folder) / "kernels.score-250.py311.dcb46d48cdac.kernel"]
    assert not_compiled(names, files) == {"activestructure_gym.mapping.kernels.score"}
    assert not_compiled(names, []) == names


@pytest.mark.slow
def test_a_first_comparison_compiles_these_kernels_and_no_others(tmp_path):
    code = (
        "import json, sys; from activestructure_gym.evaluation.running import warmup\n"
        "from activestructure_gym.ground_truth import ground_truth_of\n"
        "from activestructure_gym.scenes import load_scene\n"
        "names, call = set(), warmup.Tally.__call__\n"
        "warmup.Tally.__call__ = lambda self, name: names.add(name) or call(self, name)\n"
        "with warmup.warming_up(['random', 'activestructure'], {}):\n"
        "    ground_truth_of(load_scene('room')).observable_surface\n"
        "print(json.dumps(sorted(names)))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "a"), "ASG_CACHE_DIR": str(tmp_path / "b")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    asked = kernels_of(warmup.all_features(["random", "activestructure"]))
    assert set(json.loads(done.stdout.splitlines()[-1])) == asked
    assert not_compiled(asked, (tmp_path / "a").rglob("*.kernel")) == set()
