"""A small finished comparison and a small training run, made once per process and written out as often as needed."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from tests.fuzz._mutations import damaged_bytes, damaged_json

Files = dict[str, bytes]  # by their place in the archive, which begins with no slash

_COMPARE = (
    "compare --scenes box --policies random,pixel_only --preset fast --frames 4 --views 2 --samples 500 "
    "--engine inline --set sensor.width=48 sensor.height=32 mapper.iterations=1 volume.voxel_size=0.25"
)
_TIMING = {
    "seconds": {"planning": 0.5, "mapping": 0.25, "policy": 0.125}, "total": 1.0, "decisions": [0.5],
    "hardware": {"processor": "none", "cores": 2},
}  # fmt: skip


def asg(*arguments: str) -> int:
    """A command in this process; raises `InputError` with what it said where it refused."""
    from activestructure_gym.errors import InputError
    from activestructure_gym.evaluation.cli import main

    said = io.StringIO()
    # All kernels that are needed are compiled when the comparison is made.
    warming_up = "activestructure_gym.evaluation.running.comparison.warming_up"
    nothing = mock.patch(warming_up, lambda *_: contextlib.nullcontext())
    with nothing, contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = main(list(arguments))
    notes = ("asg: note: ", "compiling ", "compiled ")
    text = "".join(line for line in said.getvalue().splitlines(keepends=True) if not line.startswith(notes))
    if code == 2:
        if not text.startswith("asg: "):
            raise AssertionError(f"refused without a sentence: {text[:300]!r}")
        raise InputError(text.removesuffix("\n"))
    if code not in (0, 1) or "Traceback" in text:
        raise AssertionError(f"exit code {code}: {text[-300:]}")
    return code


@functools.cache
def comparison() -> Files:
    """Two runs in the box, without a clock in them, so that every process writes the same archives."""
    with tempfile.TemporaryDirectory() as place:
        if asg(*_COMPARE.split(), "--out", place) != 0:
            raise AssertionError("the comparison that is to be damaged did not finish")
        kept = {str(path.relative_to(place)): path for path in Path(place).rglob("*") if path.is_file()}
        files = {name: path.read_bytes() for name, path in kept.items() if name.partition("/")[0] == "jobs"}
        record = json.loads(kept["compare.json"].read_text())
    files["compare.json"] = json.dumps(record | {"command": _COMPARE, "hardware": _TIMING["hardware"]}).encode()
    for run in runs_of(files):
        files[f"{run}/timing.json"] = json.dumps(_TIMING).encode()
        seal(files, run)
    return dict(sorted(files.items()))


def runs_of(files: Files) -> list[str]:
    return sorted({"/".join(name.split("/")[:2]) for name in files if name.startswith("jobs/")})


def seal(files: Files, run: str) -> None:
    """Make the checksums in the run's mark those of its files, as who knows how may do."""
    first, *lines = files[f"{run}/.done"].decode("ascii", "replace").splitlines() or [""]
    names = [line.split("  ", 1)[1] for line in lines if "  " in line]
    checksums = [f"{hashlib.sha256(files[f'{run}/{n}']).hexdigest()}  {n}" for n in names if f"{run}/{n}" in files]
    files[f"{run}/.done"] = "\n".join([first, *checksums, ""]).encode()


@functools.cache
def training_run() -> Files:
    """A run of behaviour cloning that was stopped after its first epoch, with the demonstrations it learns from."""
    import torch

    from activestructure_gym.evaluation.archive.json_files import write_json
    from activestructure_gym.evaluation.training import demonstrations
    from activestructure_gym.evaluation.training.config import TrainingConfig, WorldConfig
    from activestructure_gym.evaluation.training.runs import TrainingRun, module_tensors, optimizer_tensors
    from activestructure_gym.ground_truth.layouts import layout_specs
    from activestructure_gym.policies.learned.network import CandidateNetwork

    world = WorldConfig(layouts=1, rooms=(1,), frames=5, max_planes=4, episodes_per_layout=1)
    config = TrainingConfig(world=world, episodes=1, epochs=2, planes=4, candidates=4, rounds=1, validation_layouts=1)
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as place:
        run = TrainingRun(Path(place), config)
        model = torch.nn.ModuleDict({"network": CandidateNetwork(config.network())})
        optimizer = torch.optim.AdamW(model.parameters())
        sum(parameter.sum() for parameter in model.parameters()).backward()  # type: ignore[union-attr]
        optimizer.step()
        run.finish_unit(
            {"train/loss": 0.5, "validation/auc": 0.5}, model["network"],  # type: ignore[arg-type]
            module_tensors(model) | optimizer_tensors(optimizer),
        )  # fmt: skip
        run.close()
        data = Path(place) / demonstrations.DATA
        data.mkdir()
        write_json(data / "demonstrations.json", demonstrations.description(config))
        np.savez_compressed(data / "layout-00000.npz", **_episode(config))
        specs = list(layout_specs("validation", 1, world.rooms))
        write_json(Path(place) / "references.json", {"layouts": specs, "random": [0.4], "oracle": [0.6]})
        write_json(Path(place) / "timing.json", {"sittings": 1, "parts": {}})
        kept = [path for path in Path(place).rglob("*") if path.is_file() and "tensorboard" not in path.parts]
        return {str(path.relative_to(place)): path.read_bytes() for path in sorted(kept)}


def _episode(config: Any) -> dict[str, np.ndarray]:
    """Three states of five candidates, made up."""
    from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
    from activestructure_gym.planes import PLANE_FEATURES

    rng, planes = np.random.default_rng(0), config.world.max_planes
    shapes = {
        "pose": (7,), "budget": (1,), "candidates": (5, len(CANDIDATE_COLUMNS)),
        "candidate_features": (5, len(config.world.features)), "plane_features": (planes, len(PLANE_FEATURES)),
        "plane_edges": (planes, planes), "candidate_planes": (5, planes), "scores": (5,), "rewards": (),
    }  # fmt: skip
    state = {name: rng.random((3, *shape)).astype(np.float32) for name, shape in shapes.items()}
    masks = {"action_mask": np.ones((3, 5), np.int8), "plane_mask": np.ones((3, planes), np.int8)}
    masks["candidate_planes"] = np.ones((3, 5, planes), np.int8)
    rewards = state["rewards"].astype(np.float64)
    ends = {name: np.array([False, False, True]) for name in ("ends", "terminated")}
    return {**state, **masks, **ends, "rewards": rewards, "actions": np.zeros(3, np.int16)}


def write(files: Files, folder: Path) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def damage(rng: np.random.Generator, name: str, content: bytes, others: Files) -> bytes | None:
    """The content of a file after something happened to it; None where it is gone."""
    kind = rng.integers(10)
    if kind == 0:
        return None
    if kind == 1:
        return b""
    if kind == 2:
        return others[str(rng.choice(sorted(others)))]
    if kind < 5:
        return damaged_bytes(rng, content)
    try:
        return _FORMS.get(Path(name).suffix, damaged_bytes)(rng, content)
    except (ValueError, OSError):  # an empty tree, an array that cannot be saved
        return damaged_bytes(rng, content)


def _damaged_lines(rng: np.random.Generator, content: bytes) -> bytes:
    lines = content.splitlines()
    chosen = int(rng.integers(len(lines)))
    lines[chosen] = damaged_json(rng, lines[chosen])
    return b"\n".join(lines) + b"\n"


_DTYPES = ("f2", "f8", "c16", "i1", "u8", "U5", "?", ">f4", "M8[s]", "V4")
_WIDTHS = {"f": ("f2", "f4", "f8", ">f4", ">f8"), "i": ("i1", "i2", "i4", "i8", ">i8"), "u": ("u1", "u2", "u4", "u8")}


def _other_width(rng: np.random.Generator, dtype: np.dtype[Any]) -> str:
    """The same kind of number in other bytes, now and then the same ones."""
    kind = dtype.kind if rng.random() < 0.7 else str(rng.choice(sorted(_WIDTHS)))
    return str(rng.choice(_WIDTHS.get(kind, _DTYPES)))


def damaged_npz(rng: np.random.Generator, content: bytes) -> bytes:
    """One array of it has another shape, kind or content, is gone, or lies about its size."""
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    name = str(rng.choice(sorted(arrays)))
    array = arrays[name]
    flat = array.reshape(-1)
    spoilt = flat.astype(np.float64) if array.dtype.kind in "fiub" else np.zeros(flat.size)
    if spoilt.size:
        value = float(rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, -1, 0, 2**31, 1e-320, 7, 1e9]))
        spoilt[rng.integers(spoilt.size, size=int(rng.integers(1, 4)))] = value
    changes: list[Callable[[], Any]] = [
        lambda: array[..., None],
        lambda: flat,
        lambda: array[:0] if array.ndim else array[None],
        lambda: array[: len(array) // 2] if array.ndim else array[None],
        lambda: np.concatenate([array, array]) if array.ndim else np.zeros((0,)),
        lambda: np.swapaxes(array, 0, -1) if array.ndim else array,
        lambda: array.astype(str(rng.choice(_DTYPES))),
        lambda: array.astype(_other_width(rng, array.dtype)),
        lambda: array[:-1] if array.ndim else array[None],
        lambda: np.concatenate([array, array[-1:]]) if array.ndim else np.zeros((0,)),
        lambda: np.array(None, object),
        lambda: spoilt.reshape(array.shape).astype(array.dtype, casting="unsafe"),
        lambda: spoilt.reshape(array.shape),
        lambda: np.full(array.shape, spoilt[0] if spoilt.size else 0).astype(array.dtype, casting="unsafe"),
        lambda: np.zeros((1 << 26,), np.uint8),
        lambda: np.zeros(tuple(int(n) for n in rng.integers(0, 5, size=int(rng.integers(0, 5))))),
    ]
    kind = int(rng.integers(len(changes) + 3))
    if kind < len(changes):
        with np.errstate(all="ignore"):
            arrays[name] = changes[kind]()
    elif kind == len(changes):
        del arrays[name]
    elif kind == len(changes) + 1:
        arrays["more"] = array
    stream = io.BytesIO()
    (np.savez_compressed if rng.random() < 0.5 else np.savez)(stream, **arrays)
    if kind < len(changes) + 2:
        return stream.getvalue()
    # The header of one array says that there is more, or less.
    lying = io.BytesIO()
    with zipfile.ZipFile(stream) as honest, zipfile.ZipFile(lying, "w") as archive:
        for entry in honest.namelist():
            data = honest.read(entry)
            if entry == f"{name}.npy":
                shape = str(array.shape).encode()
                other = str(tuple(int(n) * 10 ** int(rng.integers(1, 12)) for n in array.shape or (1,))).encode()
                data = data.replace(shape, other.ljust(len(shape)), 1)
            archive.writestr(entry, data)
    return lying.getvalue()


_FORMS = {".json": damaged_json, ".jsonl": _damaged_lines, ".npz": damaged_npz}


def content_of(folder: Path) -> Files:
    """Everything in a folder but locks."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def evil_module(folder: Path, rng: np.random.Generator) -> tuple[str, Path]:
    """A module in a folder that leaves a file behind when it is imported: its name, and the file."""
    name, mark = f"evil{rng.integers(10**9)}", folder / "hacked"
    mark_it = 'import pathlib\npathlib.Path(__file__).with_name("hacked").touch()\n'
    (folder / f"{name}.py").write_text(f"{mark_it}def make(): ...\n")
    return name, mark


def in_folder(folder: Path) -> None:
    os.chdir(folder)
