"""``asg export``: a run's map in a format that other programs read."""

from __future__ import annotations

from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import Export


def export(options: Export) -> int:
    """Write the file and say what is in it."""
    from activestructure_gym.evaluation.archive.store import read_run
    from activestructure_gym.evaluation.running.remeasure import read_path
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.mapping.ply import write_ply
    from activestructure_gym.mapping.splatam_file import write_splatam

    run = read_run(Path(options.run_directory))
    out = Path(options.out or ("map.ply" if options.format == "ply" else "params.npz"))
    if out.is_dir():
        raise InputError(f"'{out}' is a folder; give the name of the file to write")
    if not out.parent.is_dir():
        raise InputError(f"'{out}' cannot be written: there is no folder '{out.parent}'")
    gaussians = GaussianMap.load_npz(run.directory / "map.npz")
    try:
        if options.format == "ply":
            write_ply(gaussians, out)
        else:
            path = read_path(run.directory / "trajectory.npz")
            poses, keyframes = run.trajectory["world_from_camera"], run.trajectory["keyframes"]
            write_splatam(gaussians, out, poses, path.camera, keyframes)
    except OSError as error:
        raise InputError(f"'{out}' cannot be written: {error.strerror}") from error
    print(f"{out}: {gaussians.count} Gaussians of {run.job.title}")
    return 0
