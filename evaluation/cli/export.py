"""Define ``asg export``, which writes a run's map in a format that other programs read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from activestructure_gym.errors import InputError, one_line
from activestructure_gym.evaluation.cli.fields import Out, option
from activestructure_gym.streams import say

_FORMATS = {".ply": "ply", ".splat": "splat", ".npz": "splatam"}  # format by file extension
_NAMES = {"ply": "map.ply", "splat": "map.splat", "splatam": "params.npz"}  # default file name by format


@dataclass(frozen=True)
class Export:
    """Write a run's map for other programs."""

    run_directory: Annotated[str, tyro.conf.Positional, option("RUN")]
    """Export the map of the run in this directory."""
    format: Annotated[Literal["ply", "splat", "splatam"] | None, option("ply|splat|splatam", "")] = None
    """Write a 3DGS PLY, a .splat file, or SplaTAM's params.npz (default: by the name in --out, else ply)."""
    out: Out = None
    """Write this file, .ply, .splat or .npz (default: map.ply, map.splat or params.npz in the working directory)."""
    up: Literal["z", "y", "-y"] = "z"
    """Turn the map: z is up as in the scene, -y for most splat viewers, y for three.js and game engines."""

    def run(self) -> int:
        """Write the map file, and print its number of Gaussians and its frame in one line."""
        from activestructure_gym.evaluation.archive.store import read_run
        from activestructure_gym.evaluation.archive.temporary import writing
        from activestructure_gym.evaluation.protocols import CameraPath
        from activestructure_gym.mapping.axes import FILE_FROM_WORLD, turned_map
        from activestructure_gym.mapping.ply import write_ply
        from activestructure_gym.mapping.splat_file import write_splat
        from activestructure_gym.mapping.splatam_file import write_splatam

        out, form = destination(self)
        if form == "splatam" and self.up != "z":
            raise InputError(
                f"--up {self.up} is for ply and splat: SplaTAM's params.npz is in the frame of its first camera"
            )
        run = read_run(Path(self.run_directory))
        gaussians = run.gaussians
        if self.up != "z":
            gaussians = turned_map(gaussians, FILE_FROM_WORLD[self.up])
        with writing(out):
            if out.is_dir():
                raise InputError(f"'{out}' is a folder; give the name of the file to write")
            if not out.parent.is_dir():
                raise InputError(f"'{out}' cannot be written: there is no folder '{out.parent}'")
            if form == "ply":
                write_ply(gaussians, out, up=self.up)
            elif form == "splat":
                write_splat(gaussians, out)
            else:
                path = run.trajectory
                camera = CameraPath.from_arrays(path).camera
                write_splatam(gaussians, out, path["world_from_camera"], camera, path["keyframes"])
        frame = "in its first camera's frame" if form == "splatam" else f"{self.up} up"
        say(one_line(f"{out}: {gaussians.count} Gaussians of {run.job.title}, {frame}"))
        return 0


def destination(options: Export) -> tuple[Path, str]:
    """Return the path and the format of the file to write, from ``--out`` and ``--format``.

    Raise `InputError` if the two contradict each other, or if the file extension is not one of `_FORMATS`.
    """
    if options.out is None:
        usual = options.format or "ply"
        return Path(_NAMES[usual]), usual
    out = Path(options.out)
    form = _FORMATS.get(out.suffix.lower(), "")
    if not form:
        raise InputError(f"--out is a file that ends with .ply, .splat or .npz (SplaTAM's), got '{out}'")
    if options.format not in (None, form):
        suffix = next(suffix for suffix, name in _FORMATS.items() if name == options.format)
        raise InputError(f"--format {options.format} is written into a {suffix} file, got '{out}': give one of the two")
    return out, form
