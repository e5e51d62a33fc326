"""All folders with code are packages, tools find them, every module has one name, and importing it is light."""

from __future__ import annotations

import ast
import configparser
import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from setuptools import find_packages

from tests.parsed import nodes
from tests.requirements import closure, extras, ours

ROOT = Path(__file__).resolve().parents[1]
TOP = ("activestructure_gym", "envs", "policies", "evaluation")


def modules() -> list[Path]:
    return [path for top in TOP for path in sorted((ROOT / top).rglob("*.py")) if "__pycache__" not in path.parts]


def test_every_folder_with_code_is_a_package_that_is_found() -> None:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    assert config["options"]["packages"] == "find:"
    found = set(find_packages(str(ROOT), include=config["options.packages.find"]["include"].split()))
    folders = set()
    for module in modules():
        dotted = ".".join(module.parent.relative_to(ROOT).parts)
        folders.add(dotted if dotted.startswith("activestructure_gym") else f"activestructure_gym.{dotted}")
    assert found == folders and len(found) > 30


def test_tools_that_read_the_checkout_find_every_module() -> None:
    """Every import of this package names a file below ``activestructure_gym/``, as type checkers and editors look."""
    for module in modules():
        for node in nodes(module):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("activestructure_gym"):
                place = ROOT.joinpath(*(node.module or "").split("."))
                assert place.is_dir() or place.with_suffix(".py").is_file(), f"{module}:{node.lineno}: {node.module}"


def test_no_module_goes_by_its_short_name() -> None:
    import activestructure_gym.envs.reconstruction_env
    import activestructure_gym.evaluation.archive.jobs
    import activestructure_gym.policies  # noqa: F401

    assert not {"envs", "policies", "evaluation"} & set(sys.modules)


def test_importing_the_package_loads_no_heavy_library() -> None:
    code = (
        "import sys, activestructure_gym, activestructure_gym.policies, activestructure_gym.evaluation.cli;"
        "heavy = ('torch', 'trimesh', 'numba', 'cv2', 'matplotlib', 'pyrender', 'scipy', 'stable_baselines3');"
        "print([m for m in heavy if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert out.stdout.strip() == "[]"


def test_what_is_kept_on_disk_is_compiled_by_our_decorator() -> None:
    # numba's own would compile in silence, once in every process that starts at the same time, and would not notice
    # that another file has changed, nor that its own has been damaged.
    for path in modules():
        for node in nodes(path):
            if isinstance(node, ast.Call) and getattr(node.func, "id", None) == "njit":
                assert "cache" not in {keyword.arg for keyword in node.keywords}, f"{path}:{node.lineno}: use @kernel"


def pins() -> dict[str, Requirement]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    found = [Requirement(line) for line in lines if not line.startswith("#")]
    assert all(str(pin.specifier).startswith("==") for pin in found)
    assert len({canonicalize_name(pin.name) for pin in found}) == len(found)
    return {canonicalize_name(pin.name): pin for pin in found}


def test_every_package_that_an_install_brings_has_a_pin() -> None:
    # torch's build with CUDA names the libraries that it was built with, to the exact version.
    libraries = re.compile("(nvidia|cuda|triton)(-|$)")
    needed = {name for name in closure(ours(*extras())) if not libraries.match(name)}
    assert len(needed) > 60 and "execnet" in needed  # of pytest-xdist
    assert not needed - set(pins()), "write a version that resolves into constraints.txt"


def test_the_pins_are_within_what_setup_cfg_asks_for() -> None:
    pinned = pins()
    for wanted in ours(*extras()):
        (version,) = pinned[canonicalize_name(wanted.name)].specifier
        assert wanted.specifier.contains(version.version, prereleases=True), f"{wanted}, pinned to {version.version}"


def test_hooks_before_a_commit_run_the_pinned_versions() -> None:
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    hooks = [hook for repo in config["repos"] for hook in repo["hooks"]]
    assert [hook["id"] for hook in hooks] == ["ruff-check", "ruff-format", "codespell"]
    for hook in hooks:
        (wanted,) = map(Requirement, hook["additional_dependencies"])
        assert pins()[wanted.name].specifier == wanted.specifier


def test_workflows_install_the_pinned_versions() -> None:
    text = (ROOT / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8")
    commands = re.findall(r"pip install (.*)", text)
    assert commands
    for command in commands:
        named = re.fullmatch(r"(\w+)==(\S+) --index-url \S+", command)
        if named:
            assert str(pins()[named[1]].specifier) == f"=={named[2]}"
            continue
        given, _, names = command.partition("-c constraints.txt ")
        assert not given and names, f"pip install {command}: without a version"
        others = [name for name in names.split() if re.fullmatch(r"\w[\w-]*", name)]  # neither this package nor a wheel
        assert {canonicalize_name(name) for name in others} <= set(pins())


# What pip calls Linux on ARM, from the oldest C library that the pins run with.
ARM = {"platform_machine": "aarch64", "sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"}
ARM_TAGS = ("manylinux2014_aarch64", *(f"manylinux_2_{minor}_aarch64" for minor in range(17, 29)))
SOURCE_ONLY = {"pyopengl"}  # no wheel on the index; Python code alone, so pip builds it on any machine


def asked(environment: dict[str, str]) -> set[str]:
    wanted = ours()
    return {each.name for each in wanted if each.marker is None or each.marker.evaluate(environment)}


@pytest.mark.slow
def test_an_installation_on_linux_on_arm_resolves(tmp_path: Path) -> None:
    """With the pins, as docs/start/install.md says. pip reads the metadata of wheels and installs nothing."""
    inner = {each.name: each for each in map(Requirement, metadata.requires("pyrender") or [])}
    names = asked(ARM) - {"pyrender"}  # the only one that asks for a source distribution
    wanted = [str(Requirement(f"{each.name}{each.specifier}")) for each in ours() if each.name in names]
    wanted += [f"{each.name}{each.specifier}" for each in inner.values() if each.name.lower() not in SOURCE_ONLY]
    report = tmp_path / "report.json"
    options = ["--dry-run", "--ignore-installed", "--only-binary=:all:", "--python-version", "3.11", "--quiet"]
    options += ["--target", str(tmp_path / "target"), "--report", str(report)]
    options += [part for tag in ARM_TAGS for part in ("--platform", tag)]
    command = [sys.executable, "-m", "pip", "install", "-c", str(ROOT / "constraints.txt"), *options, *wanted]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=500)
    if "NewConnectionError" in done.stderr or "NameResolutionError" in done.stderr:
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(report.read_text(encoding="utf-8"))["install"]
    files = {
        canonicalize_name(one["metadata"]["name"]): one["download_info"]["url"].rpartition("/")[2] for one in found
    }
    assert {canonicalize_name(name) for name in names} <= set(files)
    for name in ("torch", "numba", "llvmlite", "numpy", "scipy", "opencv-python-headless", "mapbox-earcut"):
        assert files[name].endswith("aarch64.whl"), files[name]
    assert not [name for name in files.values() if "x86_64" in name]
