"""Define ``asg doctor``, which checks this machine or the folder of a dataset."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import Switch, option
from activestructure_gym.evaluation.cli.listing import print_json
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.streams import escape

_NUMBA = "numba"  # name of the kernels' backend in the table
_MAX_CHARACTERS = 20  # longest version that is printed in full; the checksum of the code has 64 characters


@dataclass(frozen=True)
class Doctor:
    """Check this machine, or a dataset's folder.

    Print every backend with its state, and the package that is missing.
    """

    dataset: Annotated[tuple[str, ...], option("replica|matterport3d PATH", "")] = ()
    """Check a dataset's folder instead, and print which scenes are complete and which files are missing or damaged."""
    json: Switch = False
    """Print JSON, with checksums in full."""

    def run(self) -> int:
        """Print the checks, and return the exit code.

        It is 0 if `asg compare` can run, or with ``dataset`` if every scene of the dataset is usable, else 1.
        """
        if self.dataset:
            return _print_dataset(*self.dataset)
        return _print_machine(json=self.json)


def _print_machine(*, json: bool) -> int:
    """Print hardware, backends with their states, and versions; return 0 if `asg compare` can run, else 1."""
    from activestructure_gym.evaluation.machine import hardware as machine

    console = make_console()
    hardware = machine.hardware()
    if json:
        needed, rows = _states()
        states = [{"part": part, "backend": backend, "state": state} for part, backend, state in rows]
        print_json({"hardware": hardware, "states": states, "versions": machine.versions()})
        return 1 if _broken(needed, rows) else 0
    console.print(f"{hardware['system']}, {hardware['processor']}, {hardware['cores']} cores, {_memory(hardware)}")
    with console.status("trying every backend"):
        needed, rows = _states()
    table = plain_table("Parts and backends", "part", "backend", "state")
    for part, backend, state in rows:
        good = state.startswith("works")
        table.add_row(part, escape(backend), f"{'[green]✓[/]' if good else '[yellow]–[/]'} {escape(state)}")
    print_whole(console, table)
    versions = plain_table("Versions", "package", "version")
    for package, version in machine.versions().items():
        short = version if len(version) <= _MAX_CHARACTERS else f"{version[:12]}…"
        versions.add_row(package, escape(short) if version != "missing" else "[red]missing[/]")
    print_whole(console, versions)
    if broken := _broken(needed, rows):
        console.print(f"[red]✗[/] `asg compare` cannot run: {', '.join(broken)} does not work")
        return 1
    console.print("[green]✓[/] `asg compare` can run")
    console.print("Help: asg COMMAND --help; of the package: python -m pydoc activestructure_gym")
    return 0


def _broken(needed: set[str], rows: list[tuple[str, str, str]]) -> list[str]:
    """Return the "part backend" of each row whose backend is in ``needed`` and does not work."""
    return [f"{part} {backend}" for part, backend, state in rows if backend in needed and state[:5] != "works"]


def _print_dataset(*asked: str) -> int:
    """Print every scene of a dataset's folder with the state of its files; return 0 if all are usable, else 1.

    ``asked`` are the name of the dataset and the path of the folder.
    """
    from activestructure_gym.scenes.dataset_check import check_dataset
    from activestructure_gym.scenes.datasets import DATASETS

    if len(asked) != 2 or asked[0] not in DATASETS:
        raise InputError(f"--dataset takes {' or '.join(DATASETS)}, and a folder; got '{' '.join(asked)}'")
    dataset, root = DATASETS[asked[0]], Path(os.path.expanduser(asked[1]))
    scenes = check_dataset(dataset, root)
    console = make_console()
    table = plain_table(f"{dataset.title} in {escape(str(root))}", "scene", "folder", "file", "state")
    signs = {"there": "[green]✓[/]", "missing": "[yellow]–[/]", "damaged": "[red]✗[/]"}
    for scene in scenes:
        name = f"{'[green]✓[/]' if scene.usable else '[red]✗[/]'} {scene.title}"
        if scene.place is None:
            table.add_row(name, scene.folder, "", "not in this folder", end_section=True)
        for number, file in enumerate(scene.files):
            needed = " (needed)" if file.needed and file.state != "there" else ""
            state = f"{signs[file.state]} {file.state}{needed}{f': {escape(file.why)}' if file.why else ''}"
            first, last = number == 0, number == len(scene.files) - 1
            place = escape(str(scene.place)) if first else ""
            table.add_row(name if first else "", place, escape(file.name), state, end_section=last)
    print_whole(console, table)
    usable = sum(scene.usable for scene in scenes)
    console.print(
        f"{usable} of {len(scenes)} scenes can be used"
        + (f"; get the dataset from {dataset.source}" if usable < len(scenes) else "")
    )
    if usable:
        one = next(scene for scene in scenes if scene.usable)
        console.print(
            f"With {dataset.variable}={escape(str(root))} they have names: --scenes {dataset.kind}:{one.folder}"
        )
    return 0 if usable == len(scenes) else 1


def _states() -> tuple[set[str], list[tuple[str, str, str]]]:
    """Try all backends; return the names of those needed by `asg compare`, and (part, backend, state) of each."""
    from activestructure_gym.evaluation.running.engines import ENGINES
    from activestructure_gym.scenes.cache import cache_directory
    from activestructure_gym.sensors.renderer import renderer_status
    from activestructure_gym.splatting.backends import backend_status

    rows = [("sensor", name, state) for name, state in renderer_status().items()]
    rows += [("rasteriser", name, state) for name, state in backend_status().items()]
    rows += [("engine", name, _engine_state(name)) for name in ENGINES]
    rows.append(("cache", str(cache_directory()), _cache_state()))
    rows.append(("kernels", *_kernels_state()))
    return {"raycast", "cpu", _NUMBA}, rows


def _engine_state(name: str) -> str:
    from activestructure_gym.evaluation.running.engines import ENGINES, Limits

    try:
        ENGINES.get(name).check(Limits())
    except InputError as error:
        return str(error)
    return "works"


def _kernels_state() -> tuple[str, str]:
    """Return the directory of the compiled kernels and the state of its files."""
    from activestructure_gym.compiling import cache_place, check_compiling
    from activestructure_gym.compiling.files import kernel_files, read

    try:
        check_compiling()
    except InputError as error:
        return _NUMBA, str(error)
    place = cache_place()
    if place is None:
        return "compiled", "cannot be kept: every process compiles them. Set NUMBA_CACHE_DIR"
    where = "next to the sources" if place.name == "__pycache__" else str(place.parent)
    files = kernel_files()
    damaged = [file for file in files if read(file) is None]
    if damaged:
        return where, f"{len(damaged)} of {len(files)} files damaged: their kernels are compiled again when needed"
    return where, f"works, {len(files)} kernels, {sum(file.stat().st_size for file in files) / 1e6:.0f} MB"


def _cache_state() -> str:
    """Return the state of the scene cache as text: whether it can be written, and its size."""
    import tempfile

    from activestructure_gym.scenes.cache import cache_directory

    directory = cache_directory()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        return f"cannot be written ({error.strerror}); everything is computed every time. Set ASG_CACHE_DIR"
    size = sum(file.stat().st_size for file in directory.glob("*.npz"))
    return f"works, {size / 1e6:.0f} MB"


def _memory(hardware: dict[str, str | int]) -> str:
    return f"{hardware['memory_gb']} GB memory" if hardware["memory_gb"] else "memory unknown"
