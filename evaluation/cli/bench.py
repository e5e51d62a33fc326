"""Define ``asg bench``, which measures the speed of sensor, rasteriser and environment on this machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from activestructure_gym.evaluation.cli.fields import Names, PresetName, Switch, option
from activestructure_gym.evaluation.cli.options import split_list, split_scenes
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.streams import escape

SceneNames = Annotated[tuple[str, ...], option("SCENE [SCENE ...]")]


@dataclass(frozen=True)
class Sensor:
    """Measure the RGB-D frames per second of the sensor by renderer and size."""

    scenes: SceneNames = ("room",)
    """Render these scenes."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        from activestructure_gym.evaluation.benchmarks.sensors import run_sensor_benchmark

        console = make_console()
        with console.status("measuring the sensor"):
            rows = run_sensor_benchmark(split_scenes(self.scenes))
        print_rows(console, rows, "speed of the sensor on this machine")
        return 0


@dataclass(frozen=True)
class Splatting:
    """Measure the rasteriser's speed in mapping and in scoring candidate views."""

    workloads: Names = ("W1", "W2", "W3", "W4")
    (
        "Measure mapping iterations in small (W1), medium (W2) and large (W3) images and maps, and the scoring of "
        "candidate views (W4)."
    )
    repeats: int = 15
    """Time everything this many times."""
    baseline: bool = True
    """Measure plain torch as well, for the ratios; this takes minutes instead of half a minute."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        from activestructure_gym.evaluation.benchmarks.information import run_information_benchmark
        from activestructure_gym.evaluation.benchmarks.splatting import run_splatting_benchmark

        console = make_console()
        with console.status("measuring the splatting") as status:

            def show(line: str) -> None:
                status.update(f"measuring the {line}")

            rows = run_splatting_benchmark(
                split_list(self.workloads), repeats=self.repeats, baseline=self.baseline, progress=show
            )
            of_keyframes = run_information_benchmark(repeats=self.repeats, progress=show)
        print_rows(console, rows, "speed of the rasteriser on this machine")
        print_rows(console, of_keyframes, "information of the keyframes for one decision, processor ms")
        return 0


@dataclass(frozen=True)
class Env:
    """Measure the steps per second of the environment in one process and in two, and the time of their stages."""

    scenes: Annotated[tuple[str, ...], option("SCENE [SCENE ...]", "(default: apartment?rooms=3; --quick: box)")] = ()
    """Take steps in these scenes."""
    preset: PresetName = "fast"
    """Use the configuration that `asg list config PRESET` prints."""
    quick: Switch = False
    """Measure one short round, as a check that the benchmark runs."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        from activestructure_gym.config import known_preset
        from activestructure_gym.evaluation.benchmarks.env import SCENES, run_env_benchmark

        console = make_console()
        size: dict[str, Any] = {"rounds": 1, "seconds": 0.5} if self.quick else {}
        with console.status("measuring the environment") as status:
            speed, rows = run_env_benchmark(
                split_scenes(self.scenes) or (["box"] if self.quick else SCENES),
                preset=known_preset(self.preset),
                notify=lambda line: status.update(f"measuring the {escape(line)}"),
                **size,
            )
        print_rows(console, speed, "steps of the environment on this machine")
        print_rows(console, rows, "where the time of a step goes, milliseconds of processor time")
        return 0


@tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
@dataclass(frozen=True)
class Bench:
    """Measure the speed of sensor, rasteriser or environment."""

    part: (
        Annotated[Sensor, tyro.conf.subcommand("sensor")]
        | Annotated[Splatting, tyro.conf.subcommand("splatting")]
        | Annotated[Env, tyro.conf.subcommand("env")]
    )
    """Measure this part."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        return self.part.run()


def print_rows(console: Console, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print ``rows`` as a table with a title."""
    print_whole(console, rows_table(rows, title=title))


def rows_table(rows: Sequence[Mapping[str, Any]], *, title: str) -> Table:
    """Return a table of ``rows`` with a column for every key; numbers are rounded to three significant digits."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = plain_table(title)
    for name in names:
        numeric = all(isinstance(row.get(name), int | float | type(None)) for row in rows)
        table.add_column(name.replace("_", " "), justify="right" if numeric else "left")
    for row in rows:
        table.add_row(*(escape(_text(row.get(name))) for name in names))
    return table


def _text(value: Any) -> str:
    if value is None or value != value:  # NaN is not equal to itself
        return "n/a"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(entry)}" for key, entry in value.items())
    if isinstance(value, tuple | list):
        return " .. ".join(_text(entry) for entry in value)
    return str(value)
