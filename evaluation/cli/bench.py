"""``asg bench``: how fast the sensor and the rasteriser are here, what is found, how good maps are, what they cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from activestructure_gym.evaluation.cli.commands import Bench
from activestructure_gym.evaluation.cli.options import split_list
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole, working

_TITLES = {
    "sensor": "speed of the sensor on this machine",
    "splatting": "speed of the rasteriser on this machine",
    "planes": "planes found on this machine, beside those of OpenCV",
    "mapping": "quality of maps on held-out views",
    "growth": "cost of one place while the map grows elsewhere",
    "grid": "the same jobs by hand and through the supervisor",
    "evaluation": "cost of an episode's evaluation, the truth in the cache",
    "policies": "seconds of a decision, median and quartiles",
    "env": "where the time of a step goes, milliseconds of processor time",
}


def bench(options: Bench) -> int:
    """Measure and print one table."""
    console = make_console()
    scenes = split_list([options.scene] if options.scene else [])
    size: dict[str, Any]
    if options.what in ("mapping", "growth"):
        from activestructure_gym.evaluation.benchmarks import mapping_command as bench_mapping

        measure = bench_mapping.measure_quality if options.what == "mapping" else bench_mapping.measure_growth
        rows = measure(console, scenes, quick=options.quick, out=options.out)
    elif options.what == "evaluation":
        from activestructure_gym.evaluation.benchmarks.episode_evaluation import measure_evaluation

        rows = measure_evaluation(console, scenes, quick=options.quick)
    elif options.what == "policies":
        from activestructure_gym.evaluation.benchmarks import policies as policy_benchmark

        few: dict[str, Any] = {"preset": "fast", "frames": 25, "repeats": 1} if options.quick else {}
        with console.status("measuring the policies") as status:
            where = scenes or ["box" if options.quick else policy_benchmark.SCENE]
            rows = [
                row | {"scene": spec}
                for spec in where
                for row in policy_benchmark.run_policy_benchmark(spec, notify=lambda line: status.update(line), **few)
            ]
    elif options.what == "planes":
        from activestructure_gym.evaluation.benchmarks import planes as benchmark
        from activestructure_gym.scenes.library import load_scene

        with console.status("measuring the planes"):
            loaded = [load_scene(spec) for spec in scenes or benchmark.SCENES]
            sizes, views, keyframes = (benchmark.SIZES[:1], 4, 8) if options.quick else (benchmark.SIZES, 20, 60)
            rows = [row for scene in loaded for row in benchmark.detection_rows(scene, sizes=sizes, views=views)]
            costs = [row for scene in loaded for row in benchmark.graph_rows(scene, keyframes=keyframes)]
        print_whole(console, rows_table(costs, title="milliseconds of the planes per decision, 256 candidates"))
    elif options.what == "env":
        from activestructure_gym.evaluation.benchmarks.env import SCENES, run_env_benchmark

        size = {"rounds": 1, "seconds": 0.5} if options.quick else {}
        with console.status("measuring the environment") as status:
            speed, rows = run_env_benchmark(
                scenes or (["box"] if options.quick else SCENES),
                preset=options.preset,
                notify=lambda line: status.update(f"measuring the {escape(line)}"),
                **size,
            )
        print_whole(console, rows_table(speed, title="steps of the environment on this machine"))
    elif options.what == "grid":
        from activestructure_gym.evaluation.benchmarks.grid import run_grid_benchmark

        size = {"frames": 8, "seeds": (0,), "repeats": 1} if options.quick else {}
        with working(console, "measuring the grid") as notify:
            chosen = scenes or (["box"] if options.quick else ["room"])
            rows = run_grid_benchmark(chosen, notify=notify, **size)
    else:
        with console.status(f"measuring the {options.what}") as status:
            if options.what == "sensor":
                from activestructure_gym.evaluation.benchmarks.sensors import run_sensor_benchmark

                rows = run_sensor_benchmark(scenes or ["room"])
            else:
                from activestructure_gym.evaluation.benchmarks.information import run_information_benchmark
                from activestructure_gym.evaluation.benchmarks.splatting import run_splatting_benchmark

                def tell(line: str) -> None:
                    status.update(f"measuring the {line}")

                rows = run_splatting_benchmark(
                    split_list(options.workloads), repeats=options.repeats, baseline=options.baseline, progress=tell
                )
                of_keyframes = run_information_benchmark(repeats=options.repeats, progress=tell)
    print_whole(console, rows_table(rows, title=_TITLES[options.what]))
    if options.what == "splatting":
        print_whole(console, rows_table(of_keyframes, title="a decision's information of the keyframes, processor ms"))
    return 0


def rows_table(rows: Sequence[Mapping[str, Any]], *, title: str) -> Table:
    """Rows of any names as a table; numbers to three digits."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = plain_table(title)
    for name in names:
        numeric = all(isinstance(row.get(name), int | float | type(None)) for row in rows)
        table.add_column(name.replace("_", " "), justify="right" if numeric else "left", no_wrap=True)
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
