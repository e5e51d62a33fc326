"""`InputError` is what a user gave, `ValueError` what a programmer did: who raises which, room by room.

The rule stands in CONTRIBUTING.md. An `InputError` is read by people: it came from the command line, a file,
`gymnasium.make`, a name or a configuration. A `ValueError` says that a function was called as it cannot be.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.parsed import tree

ROOT = Path(__file__).resolve().parents[1]
TOP = ("activestructure_gym", "envs", "policies", "evaluation")

# Everything that comes here was given by somebody; below the functions that are no entrance of theirs.
ENTRANCES = (
    "activestructure_gym/config.py",
    "activestructure_gym/reconstruction/episode.py",
    "activestructure_gym/registry.py",
    "activestructure_gym/specs.py",
    "activestructure_gym/scenes/library.py",
    "activestructure_gym/scenes/loaders/",
    "activestructure_gym/ground_truth/",
    "activestructure_gym/mapping/files.py",
    "activestructure_gym/mapping/ply.py",
    "activestructure_gym/mapping/splat_file.py",
    "activestructure_gym/mapping/splatam_file.py",
    "activestructure_gym/splatting/api.py",
    "envs/",
    "policies/",
    "evaluation/archive/",
    "evaluation/benchmarks/",
    "evaluation/cli/",
    "evaluation/protocols/",
    "evaluation/references/",
    "evaluation/report/",
    "evaluation/reproduction/",
    "evaluation/running/",
    "evaluation/training/",
    "evaluation/trajectories/",
)
# Rooms of functions: what they are given was made by other functions.
INSIDE = (
    "activestructure_gym/geometry/",
    "activestructure_gym/compiling/",
    "activestructure_gym/volume/",
    "activestructure_gym/motion/",
    "activestructure_gym/planes/",
    "activestructure_gym/splatting/",
    "activestructure_gym/mapping/",
    "activestructure_gym/sensors/",
    "evaluation/statistics/",
)
# What inside of those rooms looks at a machine, a file or a whole scene, which is the user's.
USERS_INSIDE = {
    "activestructure_gym/compiling/decorator.py": {"check_compiling"},
    "activestructure_gym/mapping/adapted.py": {"keyframe_mapper"},
    "activestructure_gym/mapping/base.py": {"BaseMapperConfig.make"},
    "activestructure_gym/mapping/systems/co_slam/mapper.py": {"CoSLAMMapper.persistent_map"},
    "activestructure_gym/mapping/gaussian_map.py": {"GaussianMap.load_npz"},
    "activestructure_gym/splatting/rasterizers.py": {"rasterizer"},
    "activestructure_gym/splatting/torch_rasterizer.py": {"TorchSteps.step"},
    "activestructure_gym/sensors/pyrender_backend.py": {"_import_gl_scene", "_context_of"},
    "activestructure_gym/sensors/renderer.py": {"_by_warp"},
    "activestructure_gym/volume/config.py": {"grid_shape"},
    "activestructure_gym/volume/rays.py": {"PixelRays.sums", "PixelRays._of_voxels"},
    "activestructure_gym/volume/voxel_volume.py": {"VoxelVolume.rays"},
}
# Who is called wrongly here, not given something wrong.
PROGRAMMERS = {
    "policies/base.py": {"best_valid"},
    "policies/gauss_mi/reliability.py": {"DirectionalReliability.update"},
    "policies/r3_recon/surface_views.py": {"SurfaceViews.update"},
    "policies/random/policy.py": {"Random.act"},
    "activestructure_gym/scenes/loaders/sequence.py": {"_parsed_camera"},  # its caller makes the sentence
    "activestructure_gym/specs.py": {"_typed"},  # as above
    "evaluation/cli/parsing.py": {"_rule.read"},  # tyro asks for it
}


@dataclass(frozen=True)
class Raise:
    """One raise statement."""

    path: str
    line: int
    where: str  # names of the classes and functions around it
    what: str

    @property
    def place(self) -> str:
        return f"{self.path}:{self.line} in {self.where}"

    @property
    def of_a_config(self) -> bool:
        return self.where.endswith("__post_init__")


@cache
def raises() -> list[Raise]:
    paths = [path for top in TOP for path in sorted((ROOT / top).rglob("*.py"))]
    return [found for path in paths for found in _raises_in(tree(path), path.relative_to(ROOT).as_posix(), ())]


def _raises_in(node: ast.AST, path: str, around: tuple[str, ...]) -> Iterator[Raise]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            continue  # which holds no statement
        named = isinstance(child, ast.FunctionDef | ast.ClassDef)
        inner = (*around, child.name) if named else around  # type: ignore[union-attr]
        if isinstance(child, ast.Raise) and child.exc is not None:
            raised = child.exc.func if isinstance(child.exc, ast.Call) else child.exc
            what = raised.attr if isinstance(raised, ast.Attribute) else getattr(raised, "id", "")
            kind = "InputError" if what in ("unknown_name", "unknown_keyword") else what
            yield Raise(path, child.lineno, ".".join(inner), kind)
        yield from _raises_in(child, path, inner)


def test_what_a_user_gave_raises_an_input_error() -> None:
    wrong = [
        found.place
        for found in raises()
        if found.what == "ValueError" and found.path.startswith(ENTRANCES)
        and found.where not in PROGRAMMERS.get(found.path, ())
    ]  # fmt: skip
    assert not wrong, f"raise InputError at an entrance: {wrong}"


def test_a_configuration_refuses_with_an_input_error() -> None:
    wrong = [
        found.place
        for found in raises()
        if found.what == "ValueError" and found.of_a_config and "Config." in found.where
    ]
    assert not wrong, f"raise InputError for a configuration's values: {wrong}"


def test_a_function_inside_raises_a_value_error() -> None:
    wrong = [
        found.place
        for found in raises()
        if found.what == "InputError" and found.path.startswith(INSIDE) and not found.path.startswith(ENTRANCES)
        and not found.of_a_config and found.where not in USERS_INSIDE.get(found.path, ())
    ]  # fmt: skip
    assert not wrong, f"raise ValueError where a function is called wrongly: {wrong}"


def test_the_exceptions_are_in_use() -> None:
    here = {(found.path, found.where) for found in raises()}
    listed = {
        (path, where) for rooms in (USERS_INSIDE, PROGRAMMERS) for path, names in rooms.items() for where in names
    }
    assert listed <= here, f"take these away: {listed - here}"
