"""Define ``asg export``, which writes a run's map, pictures, poses or surface in formats that other programs read."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from activestructure_gym.errors import InputError, one_line
from activestructure_gym.evaluation.cli.fields import Out, Switch, option
from activestructure_gym.evaluation.cli.options import use_trust
from activestructure_gym.evaluation.cli.output import make_console, working
from activestructure_gym.streams import say

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.store import Run
    from activestructure_gym.mapping.axes import UpInFile

Format = Literal["ply", "splat", "splatam", "mesh", "nerfstudio", "colmap", "tum"]
# Default name in the working directory, and the allowed file extensions; none for a folder.
_FORMATS: dict[str, tuple[str, tuple[str, ...]]] = {
    "ply": ("map.ply", (".ply",)),
    "splat": ("map.splat", (".splat",)),
    "splatam": ("params.npz", (".npz",)),
    "mesh": ("surface.glb", (".glb", ".ply")),
    "nerfstudio": ("nerfstudio", ()),
    "colmap": ("colmap", ()),
    "tum": ("trajectory.txt", (".txt",)),
}
_BY_EXTENSION = {".ply": "ply", ".splat": "splat", ".npz": "splatam", ".glb": "mesh", ".txt": "tum"}
_DATA_SETS = ("nerfstudio", "colmap")


@dataclass(frozen=True)
class Export:
    """Write a run's map, views, poses or mesh for other programs."""

    run_directory: Annotated[str, tyro.conf.Positional, option("RUN")]
    """Export the run in this directory."""
    format: Annotated[Format | None, option("|".join(_FORMATS), "")] = None
    """Write the map (ply, splat, splatam), the mesh, the views or the poses (default: by --out's name, else ply)."""
    out: Out = None
    """Write this file, or this new folder for nerfstudio and colmap (default: a name in the working directory)."""
    size: Annotated[str | None, option("WxH", "")] = None
    """Render the pictures of nerfstudio and colmap at this size in pixels (default: the sensor's)."""
    frames: Annotated[Literal["keyframes", "all"] | None, option("keyframes|all", "")] = None
    """Write the keyframes or all executed poses (default: keyframes; for tum all)."""
    up: Annotated[Literal["z", "y", "-y"] | None, option("z|y|-y", "")] = None
    """Turn map or mesh: z is up as in the scene (default; .glb: y), -y for most splat viewers, y for game engines."""
    trust_code: Switch = False
    """Run code (package.module:name) that the run names as its scene."""

    def run(self) -> int:
        """Write the file or the folder, and print its content in one line."""
        from activestructure_gym.evaluation.archive.store import read_run
        from activestructure_gym.evaluation.archive.temporary import writing

        out, form = destination(self)
        size = _checked(self, form)
        use_trust(self.trust_code)
        run = read_run(Path(self.run_directory))
        with writing(out):
            if form not in _DATA_SETS and out.is_dir():
                raise InputError(f"'{out}' is a folder; give the name of the file to write")
            if not out.absolute().parent.is_dir():
                raise InputError(f"'{out}' cannot be written: there is no folder '{out.parent}'")
            if form in _DATA_SETS:
                content = _write_data_set(run, out, form, self.frames or "keyframes", size)
            elif form == "tum":
                content = _write_poses(run, out, self.frames or "all")
            elif form == "mesh":
                content = _write_mesh(run, out, self.up or ("y" if out.suffix.lower() == ".glb" else "z"))
            else:
                content = _write_map(run, out, form, self.up or "z")
        say(one_line(f"{out}: {content}"))
        return 0


def destination(options: Export) -> tuple[Path, str]:
    """Return the path and the format to write, from ``--out`` and ``--format``.

    Raise `InputError` if the two contradict each other, or if neither names a format.
    """
    if options.out is None:
        form = options.format or "ply"
        return Path(_FORMATS[form][0]), form
    out = Path(options.out)
    extension = out.suffix.lower()
    if options.format is None:
        if extension not in _BY_EXTENSION:
            raise InputError(
                f"--out is a file that ends with {', '.join(_BY_EXTENSION)}, got '{out}'; for a folder also give "
                f"--format {' or '.join(_DATA_SETS)}"
            )
        return out, _BY_EXTENSION[extension]
    allowed = _FORMATS[options.format][1]
    if allowed and extension not in allowed:
        raise InputError(
            f"--format {options.format} is written into a {' or '.join(allowed)} file, got '{out}': give one of the two"
        )
    return out, options.format


def _checked(options: Export, form: str) -> tuple[int, int] | None:
    """Return the size of the pictures; raise `InputError` for options that the format does not have."""
    if form == "splatam" and options.up not in (None, "z"):
        raise InputError(
            f"--up {options.up} is for ply and splat: SplaTAM's params.npz is in the frame of its first camera"
        )
    if options.up is not None and form in (*_DATA_SETS, "tum"):
        raise InputError(f"--up is for maps and meshes: {form} has the scene's world, z up; leave it out")
    if options.frames is not None and form not in (*_DATA_SETS, "tum"):
        raise InputError(f"--frames is for nerfstudio, colmap and tum: {form} has no frames; leave it out")
    if options.size is None:
        return None
    if form not in _DATA_SETS:
        raise InputError(f"--size is for nerfstudio and colmap: {form} has no pictures; leave it out")
    sides = re.fullmatch(r"(\d{1,6})x(\d{1,6})", options.size)
    if sides is None:
        raise InputError(f"--size is width x height in pixels, such as 1200x680, got '{options.size}'")
    return int(sides[1]), int(sides[2])


def _write_data_set(
    run: Run, out: Path, form: str, frames: Literal["keyframes", "all"], size: tuple[int, int] | None
) -> str:
    """Write the pictures, poses and seed points into a new folder, and return a description."""
    from activestructure_gym.evaluation.archive.temporary import atomic_files
    from activestructure_gym.evaluation.export import posed_frames, write_colmap, write_nerfstudio
    from activestructure_gym.evaluation.export.dataset import seed_points

    if out.exists() and (not out.is_dir() or any(not file.name.startswith(".files-") for file in out.iterdir())):
        raise InputError(f"'{out}' exists already and is not an empty folder: choose another folder, or remove it")
    with working(make_console(), "loading the run") as update:
        views = posed_frames(run, frames, size)

        def report(done: int) -> None:
            update(f"drawing {done} of {len(views)} pictures")

        write: Callable[..., None] = write_colmap if form == "colmap" else write_nerfstudio
        with atomic_files(out) as part:
            write(views, run.gaussians, part, report)
    pictures = f"{len(views)} pictures of {views.camera.width} x {views.camera.height} pixels with depth"
    return f"{pictures} and {len(seed_points(run.gaussians)[0])} seed points of {run.job.title}, z up, metres"


def _write_poses(run: Run, out: Path, frames: Literal["keyframes", "all"]) -> str:
    from activestructure_gym.evaluation.export import write_tum
    from activestructure_gym.evaluation.export.frames import chosen_numbers

    numbers = chosen_numbers(run, frames)
    write_tum(numbers, run.trajectory["world_from_camera"][numbers], out)
    return f"{len(numbers)} poses of {run.job.title}, world from camera, z up, metres"


def _write_mesh(run: Run, out: Path, up: UpInFile) -> str:
    from activestructure_gym.evaluation.export import surface_mesh, write_mesh

    with working(make_console(), "fusing the surface"):
        mesh = surface_mesh(run)
        write_mesh(mesh, out, up)
    return f"{len(mesh.faces)} triangles of {run.job.title}, {up} up"


def _write_map(run: Run, out: Path, form: str, up: UpInFile) -> str:
    from activestructure_gym.evaluation.protocols import CameraPath
    from activestructure_gym.mapping.axes import FILE_FROM_WORLD, turned_map
    from activestructure_gym.mapping.ply import write_ply
    from activestructure_gym.mapping.splat_file import write_splat
    from activestructure_gym.mapping.splatam_file import write_splatam

    gaussians = run.gaussians
    if up != "z":
        gaussians = turned_map(gaussians, FILE_FROM_WORLD[up])
    if form == "ply":
        write_ply(gaussians, out, up=up)
    elif form == "splat":
        write_splat(gaussians, out)
    else:
        path = run.trajectory
        camera = CameraPath.from_arrays(path).camera
        write_splatam(gaussians, out, path["world_from_camera"], camera, path["keyframes"])
    frame = "in its first camera's frame" if form == "splatam" else f"{up} up"
    return f"{gaussians.count} Gaussians of {run.job.title}, {frame}"
