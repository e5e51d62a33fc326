"""The package list equals the folders, every module has one name, and importing it is light."""

from __future__ import annotations

import ast
import configparser
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOP = ("activestructure_gym", "envs", "policies", "evaluation")


def modules() -> list[Path]:
    return [path for top in TOP for path in sorted((ROOT / top).rglob("*.py")) if "__pycache__" not in path.parts]


def test_package_list_equals_the_folders() -> None:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    listed = set(config["options"]["packages"].split())
    found = set()
    for top in TOP:
        for init in (ROOT / top).rglob("__init__.py"):
            dotted = ".".join(init.parent.relative_to(ROOT).parts)
            found.add(dotted if top == "activestructure_gym" else f"activestructure_gym.{dotted}")
    assert listed == found


def test_no_module_goes_by_its_short_name() -> None:
    import activestructure_gym.envs.reconstruction_env
    import activestructure_gym.evaluation.archive.jobs
    import activestructure_gym.policies  # noqa: F401

    assert not {"envs", "policies", "evaluation"} & set(sys.modules)


def test_importing_the_package_loads_no_heavy_library() -> None:
    code = (
        "import sys, activestructure_gym, activestructure_gym.policies, activestructure_gym.evaluation.cli;"
        "heavy = ('torch', 'trimesh', 'numba', 'cv2', 'matplotlib', 'pyrender', 'scipy');"
        "print([m for m in heavy if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert out.stdout.strip() == "[]"


def test_what_is_kept_on_disk_is_compiled_by_our_decorator() -> None:
    # numba's own would compile in silence, once in every process that starts at the same time, and would not notice
    # that another file has changed, nor that its own has been damaged.
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", None) == "njit":
                assert "cache" not in {keyword.arg for keyword in node.keywords}, f"{path}:{node.lineno}: use @kernel"
