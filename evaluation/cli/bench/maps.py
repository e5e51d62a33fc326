"""``asg bench mapping`` and ``asg bench growth``: how well maps show held-out views, and what their size costs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console

from activestructure_gym.evaluation.cli.bench.tables import SceneNames, print_rows, split_names
from activestructure_gym.evaluation.cli.fields import PathName, Switch, option
from activestructure_gym.evaluation.cli.output import make_console, progress_bar
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.streams import escape


@dataclass(frozen=True)
class Mapping:
    """Quality of maps on held-out views, by every recipe of the mapper."""

    scene: SceneNames = None
    """The scenes that are mapped, separated by commas; two apartments if not given."""
    out: PathName = None
    """Directory for mapping.jpg and mapping.json; only printed if not given."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        console = make_console()
        rows = _quality(console, split_names(self.scene), quick=self.quick, out=self.out)
        print_rows(console, rows, "quality of maps on held-out views")
        return 0


@dataclass(frozen=True)
class Growth:
    """What one place costs while the map grows elsewhere, to millions of Gaussians, and the map's memory."""

    scene: Annotated[str | None, option("SCENE", "")] = None
    """The scene that is mapped; an apartment if not given."""
    out: PathName = None
    """Directory for growth.jpg and growth.json; only printed if not given."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        console = make_console()
        rows = _growth(console, self.scene, quick=self.quick, out=self.out)
        print_rows(console, rows, "cost of one place while the map grows elsewhere")
        return 0


def _quality(console: Console, scenes: Sequence[str], *, quick: bool, out: str | None) -> list[dict[str, Any]]:
    from activestructure_gym.evaluation.benchmarks.mapping import (
        PROCEDURAL_SCENES,
        RECIPES,
        quality_steps,
        run_quality_benchmark,
    )
    from activestructure_gym.evaluation.benchmarks.mapping_figures import quality_row, quality_strip, with_means
    from activestructure_gym.scenes.library import load_scene

    keyframes, views, recipes = (10, 3, RECIPES[::3]) if quick else (60, 24, RECIPES)
    size = (96, 54) if quick else (160, 90)
    with console.status("loading the scenes"):
        loaded = [load_scene(spec) for spec in scenes or (("box",) if quick else PROCEDURAL_SCENES)]
    rows, courses, results = [], [], []
    with _progress(console, quality_steps(len(loaded), len(recipes), keyframes, views)) as advance:
        for course, mapped in run_quality_benchmark(
            loaded, recipes=recipes, keyframes=keyframes, views=views, size=size, advance=advance
        ):
            rows += [quality_row(course, entry) for entry in mapped]
            courses.append(course)
            results.append(mapped)
    rows = with_means(rows)
    if out is not None:
        folder = _write(out, "mapping.json", {"keyframes": keyframes, "views": views, "size": size}, rows)
        quality_strip(courses, results).save(folder / "mapping.jpg", quality=85)
        console.print(f"written: {escape(str(folder / 'mapping.jpg'))}, {escape(str(folder / 'mapping.json'))}")
    return rows


def _growth(console: Console, spec: str | None, *, quick: bool, out: str | None) -> list[dict[str, Any]]:
    import numpy as np

    from activestructure_gym.evaluation.benchmarks import copies, growth
    from activestructure_gym.evaluation.benchmarks.mapping_figures import plot_growth
    from activestructure_gym.mapping import Mapper, MapperConfig
    from activestructure_gym.scenes.library import load_scene

    checkpoints, pair = ((2, 4, 27), (4, 27)) if quick else (growth.CHECKPOINTS, growth.PAIR)
    size, scored, probes = ((96, 54), 8, 2) if quick else (growth.SIZE, growth.SCORED, 15)
    with console.status("loading the scene"):
        scene = load_scene(spec or ("box" if quick else growth.SCENE))
    mapper = Mapper(MapperConfig(), np.random.default_rng(0))
    with _progress(console, growth.growth_steps(checkpoints)) as advance:
        measured, compared = growth.run_growth_benchmark(
            scene, mapper, checkpoints=checkpoints, size=size, scored=scored, probes=probes, pair=pair, advance=advance
        )
    rows = [asdict(row) for row in measured]
    counts, keyframes = ((30_000,), (2, 20)) if quick else (copies.COUNTS, copies.KEYFRAMES)
    with _progress(console, 2 * len(counts)) as advance:
        among = copies.run_copies_benchmark(
            scene,
            Mapper(MapperConfig(), np.random.default_rng(0)),
            counts=counts,
            keyframes=keyframes,
            size=size,
            probes=probes,
            advance=advance,
        )
    for row in among:
        low, middle, high = row.event_ratio
        console.print(
            f"an event among copies ({row.where}), {row.gaussians[1]:,} Gaussians, costs {middle:.2f} "
            f"[{low:.2f}, {high:.2f}] times that with {row.gaussians[0]:,} ({row.pairs} pairs; "
            f"{row.event_ms[0]:.0f} and {row.event_ms[1]:.0f} ms)"
        )
    console.print(f"the map's arrays take {among[-1].mb_per_million:.0f} MB a million Gaussians of room")
    for name, (low, middle, high) in (("an event", compared.event_ratio), ("a decision", compared.decision_ratio)):
        console.print(
            f"{name} with {compared.keyframes[1]} keyframes costs {middle:.2f} [{low:.2f}, {high:.2f}] times that with "
            f"{compared.keyframes[0]} ({compared.pairs} pairs)"
        )
    if out is not None:
        settings = {"scene": scene.name, "size": size, "scored": scored, "pair": asdict(compared)}
        settings["copies"] = [asdict(row) for row in among]
        folder = _write(out, "growth.json", settings, rows)
        plot_growth(measured, folder / "growth.jpg", title="One place, looked at again while the map grows elsewhere")
        console.print(f"written: {escape(str(folder / 'growth.jpg'))}, {escape(str(folder / 'growth.json'))}")
    return rows


def _write(out: str, name: str, settings: dict[str, Any], rows: Sequence[dict[str, Any]]) -> Path:
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    content = {"settings": settings, "hardware": machine.hardware(), "rows": rows}
    (folder / name).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return folder


@contextmanager
def _progress(console: Console, steps: int) -> Iterator[Any]:
    """A bar; gives the function that moves it on by one step."""
    with progress_bar(console, disable=not console.is_terminal) as bar:
        task = bar.add_task("measuring", total=steps)
        yield lambda: bar.advance(task)
