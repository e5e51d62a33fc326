"""``asg export``: a run's map in a format that other programs read."""

from __future__ import annotations

from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import Export

_FORMATS = {".ply": "ply", ".splat": "splat", ".npz": "splatam"}
_NAMES = {"ply": "map.ply", "splat": "map.splat", "splatam": "params.npz"}


def export(options: Export) -> int:
    """Write the file and say what is in it."""
    from activestructure_gym.evaluation.archive.store import read_run
    from activestructure_gym.evaluation.protocols import CameraPath
    from activestructure_gym.mapping.ply import write_ply
    from activestructure_gym.mapping.splat_file import write_splat
    from activestructure_gym.mapping.splatam_file import write_splatam
    from activestructure_gym.mapping.turning import FILE_FROM_WORLD, turned_map

    out, form = destination(options)
    if form == "splatam" and options.up != "z":
        raise InputError(
            f"--up {options.up} is for ply and splat: SplaTAM's params.npz lies in the frame of its first camera"
        )
    run = read_run(Path(options.run_directory))
    gaussians = run.gaussians
    if options.up != "z":
        gaussians = turned_map(gaussians, FILE_FROM_WORLD[options.up])
    try:
        if out.is_dir():
            raise InputError(f"'{out}' is a folder; give the name of the file to write")
        if not out.parent.is_dir():
            raise InputError(f"'{out}' cannot be written: there is no folder '{out.parent}'")
        if form == "ply":
            write_ply(gaussians, out, up=options.up)
        elif form == "splat":
            write_splat(gaussians, out)
        else:
            path = run.trajectory
            camera = CameraPath.from_arrays(path).camera
            write_splatam(gaussians, out, path["world_from_camera"], camera, path["keyframes"])
    except OSError as error:
        raise InputError(f"'{out}' cannot be written: {error.strerror}") from error
    frame = "in its first camera's frame" if form == "splatam" else f"{options.up} up"
    print(f"{out}: {gaussians.count} Gaussians of {run.job.title}, {frame}")
    return 0


def destination(options: Export) -> tuple[Path, str]:
    """The file and its format, which the file's name and --format have to agree about; raises `InputError`."""
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
