"""``asg evaluate``: the numbers of finished runs, measured again from their stored maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import Evaluate
from activestructure_gym.evaluation.cli.output import plain_table, print_whole

if TYPE_CHECKING:
    from activestructure_gym.evaluation.store import Run

_SHOWN = ("accuracy_cm", "completion_cm", "completion_ratio", "precision", "psnr", "ssim", "depth_l1_cm")


def evaluate(options: Evaluate) -> int:
    """Print stored and new numbers; 0 if all are identical to the last bit, else 1."""
    console = Console(highlight=False)
    runs = _open(options.runs)
    table = plain_table("measured again", "run", *_SHOWN, "same")
    different = 0
    for run in runs:
        with console.status(f"measuring {run.job.title}"):
            numbers = measure_again(run)
        same = all(run.metrics["metrics"][name] == value for name, value in numbers.items())
        different += not same
        table.add_row(run.job.title, *(_text(numbers[name]) for name in _SHOWN), "[green]✓[/]" if same else "[red]✗[/]")
    print_whole(console, table)
    if different:
        console.print(f"[red]✗[/] {different} of {len(runs)} differ from what the run stored")
        return 1
    console.print("[green]✓[/] every number is identical to the stored one, bit for bit")
    return 0


def measure_again(run: Run) -> dict[str, Any]:
    """The protocol's numbers from ``map.npz`` alone."""
    from activestructure_gym.evaluation.episode import load_job_scene, measure
    from activestructure_gym.evaluation.store import plain
    from activestructure_gym.mapping import GaussianMap

    scene = load_job_scene(run.job)
    return plain(measure(run.job, run.job.protocol.truth(scene), GaussianMap.load_npz(run.directory / "map.npz")))


def _open(names: tuple[str, ...]) -> list[Run]:
    from activestructure_gym.evaluation.comparison import open_comparison
    from activestructure_gym.evaluation.store import COMPARISON, read_run

    if not names:
        raise InputError("asg evaluate needs the directory of a comparison or of a run")
    runs: list[Run] = []
    for name in names:
        directory = Path(name)
        runs += open_comparison(directory) if (directory / COMPARISON).is_file() else [read_run(directory)]
    if not runs:
        raise InputError(f"there is no finished run in {', '.join(names)}")
    return runs


def _text(value: float | None) -> str:
    return "n/a" if value is None else f"{value:.4g}"
