"""Define ``asg evaluate``, which measures the stored maps of finished runs again, or a map file of any origin."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.table import Table

from activestructure_gym.errors import InputError, listed, pluralised
from activestructure_gym.evaluation.cli.fields import NoNames, Out, PathName, Runs, Switch, option
from activestructure_gym.evaluation.cli.options import split_list, use_lpips_weights, use_trust
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.streams import complain, escape

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.store import Run


@dataclass(frozen=True)
class Evaluate:
    """Measure stored maps again, or a map file of any origin.

    Print whether the numbers of finished runs are reproduced. Finish runs whose episodes were played and not measured
    yet. With --map and --scene, measure a map file.
    """

    runs: Runs = ()
    """Measure these: directories of runs or of comparisons."""
    protocols: NoNames = ()
    """Measure by these protocols, and store new numbers: standard, activegamer,
    activesplat, naruto, offline (default: the run's own)."""
    map: PathName = None
    """Measure a map file instead of runs: 3DGS PLY, SplaTAM's params.npz, or a run's map.npz."""
    scene: Annotated[str | None, option("SCENE", "")] = None
    """Compare --map with this scene."""
    poses: PathName = None
    """Read the camera poses of --map from this trajectory.npz; the TSDF surface needs them."""
    out: Out = None
    """Write the numbers of --map to this JSON file."""
    trust_code: Switch = False
    """Run code (package.module:Name) that the runs' files name."""
    lpips_weights: PathName = None
    """Read AlexNet's and LPIPS's weights from this folder (default: ASG_LPIPS_WEIGHTS, or torch's hub cache)."""

    def run(self) -> int:
        """Measure the maps again, print the numbers, and return the exit code.

        It is 0 if all stored numbers are reproduced bit by bit and all new numbers could be written, else 1.
        """
        use_trust(self.trust_code)
        use_lpips_weights(self.lpips_weights)
        if self.map is not None:
            return _evaluate_map(self)
        if self.scene or self.poses or self.out:
            raise InputError("--scene, --poses and --out belong to --map FILE; a run knows its own scene and poses")
        from activestructure_gym.evaluation.archive.store import write_evaluation
        from activestructure_gym.evaluation.reproduction.remeasure import differing, measure_again, protocols_of

        console = make_console()
        finished = {str(run.directory) for run in _finish_played(self.runs, console)}
        runs = _open(self.runs)
        rows = list[tuple[list[str], dict[str, Any]]]()
        compared, different, added = 0, 0, 0
        lost = list[str]()
        reasons: dict[str, str] = {}
        for run in runs:
            for protocol, stored in protocols_of(run, split_list(self.protocols)):
                if stored is not None and str(run.directory) in finished:
                    reasons |= stored["notes"]
                    rows.append(([escape(run.job.title), protocol.name, "new"], stored))
                    continue
                with console.status(escape(f"measuring {run.job.title} by {protocol.name}")):
                    numbers = measure_again(run, protocol)
                wrong = differing(stored, numbers) if stored is not None else []
                different += bool(wrong)
                compared += stored is not None
                if stored is None or (not wrong and stored["lpips"] is None and numbers["lpips"] is not None):
                    try:
                        write_evaluation(run.directory, protocol.parameters(), run.job.scene_hash, numbers)
                        added += 1
                    except InputError as error:  # the numbers are printed even if they cannot be written
                        lost.append(str(error))
                reasons |= numbers["notes"]
                mark = "new" if stored is None else "[red]✗[/] " + ", ".join(wrong) if wrong else "[green]✓[/]"
                rows.append(([escape(run.job.title), protocol.name, mark], numbers))
        print_whole(console, _table("measured again", ["run", "protocol", "same"], rows))
        _print_reasons(console, reasons)
        if finished:
            console.print(f"{pluralised(len(finished), 'run')} finished, whose episodes were played before")
        if added:
            console.print(f"{added} measured for the first time, kept in the runs' folders evaluations/")
        for reason in lost:
            console.print(f"[red]✗[/] not kept: {escape(reason)}")
        if different:
            console.print(f"[red]✗[/] {different} of {compared} differ from what the run stored")
            return 1
        if compared:
            console.print("[green]✓[/] every stored number is identical, bit for bit")
        return 1 if lost else 0


def _evaluate_map(options: Evaluate) -> int:
    """Measure the map file ``options.map`` against the scene ``options.scene``, print the numbers, and return 0."""
    from activestructure_gym.evaluation.archive.json_files import write_json
    from activestructure_gym.evaluation.archive.temporary import writing
    from activestructure_gym.evaluation.protocols import get_protocol
    from activestructure_gym.evaluation.reproduction.remeasure import measure_file

    if options.runs:
        raise InputError("give finished runs, or a map with --map FILE --scene SPEC, not both")
    if not options.scene:
        raise InputError("--map needs --scene, the scene that the map is compared with")
    assert options.map is not None
    console = make_console()
    names = split_list(options.protocols) or ("standard",)
    if options.out and not Path(options.out).absolute().parent.is_dir():
        raise InputError(f"'{options.out}' cannot be written: there is no folder '{Path(options.out).parent}'")
    results: dict[str, Any] = {}
    reasons: dict[str, str] = {}
    for name in names:
        protocol = get_protocol(name)
        with console.status(f"measuring by {escape(name)}"):
            numbers = measure_file(options.map, options.scene, protocol, poses=options.poses)
        reasons |= numbers["notes"]
        results[name] = {"parameters": protocol.parameters(), "metrics": numbers}
    title = escape(f"{Path(options.map).name} on {options.scene}")
    print_whole(console, _table(title, ["protocol"], [([name], found["metrics"]) for name, found in results.items()]))
    _print_reasons(console, reasons)
    if options.out:
        with writing(options.out):
            write_json(Path(options.out), {"map": options.map, "scene": options.scene, "protocols": results})
        console.print(f"written: {escape(options.out)}")
    return 0


def _open(names: tuple[str, ...]) -> list[Run]:
    from activestructure_gym.evaluation.archive.comparison import open_comparison, read_record
    from activestructure_gym.evaluation.archive.store import COMPARISON, read_run

    if not names:
        raise InputError("name the directory of a comparison or of a run, or give --map FILE --scene SPEC")
    runs: list[Run] = []
    for name in names:
        directory = Path(name)
        if not (directory / COMPARISON).is_file():
            runs.append(read_run(directory))
            continue
        finished, asked = open_comparison(directory), len((read_record(directory) or {"jobs": ()})["jobs"])
        runs += finished
        if len(finished) < asked:
            left = asked - len(finished)
            complain(f"note: {left} of {asked} runs in '{directory}' are not finished, and are left out")
    if not runs:
        raise InputError(f"there is no finished run in {listed(names)}")
    return runs


def _finish_played(names: tuple[str, ...], console: Console) -> list[Run]:
    """Measure the episodes that were played and not yet measured, and return their runs.

    ``names`` are directories of runs and of comparisons.
    """
    from activestructure_gym.evaluation.archive.comparison import jobs_of, read_record, run_directory
    from activestructure_gym.evaluation.archive.directory_lock import hold
    from activestructure_gym.evaluation.archive.played import is_played
    from activestructure_gym.evaluation.running.measuring import measure_played

    runs: list[Run] = []
    for directory in map(Path, names):
        record = read_record(directory)
        jobs = [] if record is None else jobs_of(record, directory)
        places = [run_directory(directory, job) for job in jobs] if record is not None else [directory]
        places = [place for place in places if is_played(place)]
        if not places:
            continue
        with nullcontext() if record is None else hold(directory, shared=True):
            for place in places:
                with console.status(escape(f"measuring the episode played in {place.name}")):
                    run = measure_played(place)
                runs += [run] if run is not None else []
    return runs


def _print_reasons(console: Console, reasons: dict[str, str]) -> None:
    for name, reason in reasons.items():
        console.print(f"[dim]{escape(f'{name}: n/a, {reason}')}")


def _table(title: str, heads: Sequence[str], rows: Sequence[tuple[list[str], dict[str, Any]]]) -> Table:
    """Return a table whose rows consist of texts, headed by ``heads``, and of metrics by key.

    Metrics have the column headings of reports. Metrics without a value in any row are left out.
    """
    from activestructure_gym.evaluation.report.tables.columns import QUALITY

    columns = [column for column in QUALITY if any(numbers.get(column.key) is not None for _, numbers in rows)]
    table = plain_table(title, *heads, *(column.title for column in columns))
    for words, numbers in rows:
        table.add_row(*words, *(_text(numbers.get(column.key)) for column in columns))
    return table


def _text(value: float | None) -> str:
    return "n/a" if value is None else f"{value:.4g}"
