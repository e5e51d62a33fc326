"""The summary of a comparison: everything a reader needs, in one directory, starting at ``summary.md``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from activestructure_gym.evaluation.jobs import slug
from activestructure_gym.evaluation.report.curves import plot_convergence
from activestructure_gym.evaluation.report.phases import plot_phases
from activestructure_gym.evaluation.report.pictures import compare_plans, compare_views
from activestructure_gym.evaluation.report.planes_pictures import compare_planes_3d, compare_planes_plans
from activestructure_gym.evaluation.report.tables import markdown_table, runs_csv, table_rows
from activestructure_gym.evaluation.store import Run

# What stands above a picture of a scene's section, by the start of its file name.
_LINES = {
    "psg_plans": "Plane Scene Graphs from above: walls as strokes on the side they were seen from, deficits, holes.",
    "psg_3d": "Plane Scene Graphs in three dimensions, without the faces that look away from the viewer.",
    "phases": "Mean deficit of the planes over the frames paid, and the phases of policies that have them.",
}


def write_report(directory: Path, runs: Sequence[Run], comparison: Mapping[str, Any]) -> list[Path]:
    """Write ``results.csv``, the curves, the pictures and ``summary.md``; returns the files, the summary last.

    ``comparison`` is the content of ``compare.json``. Only finished runs are given, and only they are counted.
    """
    results = directory / "results.csv"
    results.write_text(runs_csv(runs), encoding="utf-8")
    written = [results]
    by_scene: dict[str, list[Run]] = {}
    for run in runs:
        by_scene.setdefault(run.scene, []).append(run)
    sections = []
    for (scene, own), ending in zip(by_scene.items(), _endings(list(by_scene))):
        pictures = _scene_pictures(directory, scene, own, ending)
        written += pictures.values()
        sections.append(_scene_section(scene, own, pictures, directory))
    if len(by_scene) > 1:
        whole = directory / "convergence.png"
        plot_convergence(runs, whole, title=f"Convergence, mean over {len(by_scene)} scenes")
        written.append(whole)
        sections.insert(0, f"## All scenes\n\n![convergence](./{whole.name})\n")
    summary = directory / "summary.md"
    summary.write_text(_page(runs, comparison, sections), encoding="utf-8")
    return [*written, summary]


def _endings(scenes: Sequence[str]) -> list[str]:
    """What the file names of each scene's pictures end with; "a b" and "a?b" look the same in a file name."""
    if len(scenes) == 1:
        return [""]
    endings: list[str] = []
    for scene in scenes:
        plain, number = f"-{slug(scene)}", 1
        ending = plain
        while ending.lower() in (taken.lower() for taken in endings):  # some file systems ignore case
            number += 1
            ending = f"{plain}-{number}"
        endings.append(ending)
    return endings


def _scene_pictures(directory: Path, scene: str, runs: Sequence[Run], ending: str) -> dict[str, Path]:
    paths = {name: directory / f"{name}{ending}.png" for name in ("convergence", "views", "plans")}
    plot_convergence(runs, paths["convergence"], title=f"Convergence on {scene}")
    # One run per policy: the first seed that all of them finished, else each one's first.
    policies = list(dict.fromkeys(run.job.policy for run in runs))
    seeds = [{run.job.seed for run in runs if run.job.policy == policy} for policy in policies]
    common = set.intersection(*seeds)
    shown = []
    for policy, own in zip(policies, seeds):
        seed = min(common or own)
        shown.append(next(run for run in runs if run.job.policy == policy and run.job.seed == seed))
    compare_views(shown, title=f"Held-out views of {scene}").save(paths["views"])
    compare_plans(shown, title=f"{scene} from above, seed {shown[0].job.seed}").save(paths["plans"])
    with_graph = [run for run in shown if run.graph is not None]
    if with_graph:
        paths |= {name: directory / f"{name}{ending}.png" for name in _LINES}
        compare_planes_plans(with_graph, title=f"Planes of {scene} from above").save(paths["psg_plans"])
        compare_planes_3d(with_graph, title=f"Planes of {scene}").save(paths["psg_3d"])
        episodes = [(f"{run.job.policy}, seed {run.job.seed}", run.steps) for run in with_graph]
        plot_phases(episodes, paths["phases"], title=f"Deficit and phases on {scene}", gains=False)
    return paths


def _scene_section(scene: str, runs: Sequence[Run], pictures: Mapping[str, Path], directory: Path) -> str:
    info = runs[0].config["scene"]
    size = " x ".join(f"{side:.1f}" for side in info["extent_m"])
    metrics = runs[0].metrics["metrics"]
    seen = f"{metrics['true_area_m2']:.1f} m2 of surface can be seen ({metrics['true_samples']:,} samples)"
    lines = [f"## {scene}", "", f"{info['triangles']:,} triangles, {size} m, from {info['source']}; {seen}."]
    lines += [f"Note: {note}." for note in info["notes"]]
    for name, path in pictures.items():
        lines += ["", *([_LINES[name], ""] if name in _LINES else []), f"![{name}](./{path.name})"]
    lines += ["", "Runs: " + ", ".join(_link(run, directory) for run in runs) + ".", ""]
    return "\n".join(lines)


def _link(run: Run, directory: Path) -> str:
    return f"[{run.job.policy} seed {run.job.seed}](./{run.directory.relative_to(directory).as_posix()}/)"


def _page(runs: Sequence[Run], comparison: Mapping[str, Any], sections: Sequence[str]) -> str:
    job = runs[0].job
    protocol = job.protocol
    views = (
        f"{protocol.views} views drawn in free space"
        if protocol.view_source == "free_space"
        else "the views recorded with the scene"
    )
    failed = comparison.get("failed") or {}
    missing = [f"- {name}: {reason}" for name, reason in failed.items()]
    seeds = len({run.job.seed for run in runs})
    collisions = sum(run.metrics["metrics"]["collisions"] for run in runs)
    return "\n".join(
        [
            "# Comparison",
            "",
            f"`{comparison['command']}`",
            "",
            markdown_table(table_rows(runs)),
            f"{'Mean ± standard deviation over ' + str(seeds) + ' seeds' if seeds > 1 else 'One seed'}; the best of "
            f"each scene in bold. Executed steps through the true mesh: {collisions}.",
            *(["", f"Not finished, and not counted ({len(missing)}):", "", *missing] if missing else []),
            "",
            *sections,
            "## How it was measured",
            "",
            f"Protocol `{protocol.name}`, version {protocol.version}. Reconstructed points are the means of Gaussians "
            f"with opacity of at least {protocol.opacity_threshold:g}; the truth is the surface that some free pose "
            f"can see (those of {protocol.surface_samples:,} samples on the whole mesh that are seen). "
            "Acc: mean distance from the points to that surface. "
            "Com.: mean distance from the surface to the points. C.R. and Prec.: shares of surface and of points "
            f"nearer than {100 * protocol.threshold_m:g} cm. PSNR (pooled over the channels) and SSIM: means over "
            f"{views}, {protocol.view_width} x {protocol.view_height} pixels, "
            f"{protocol.view_supersample} x {protocol.view_supersample} rays per pixel, the same for every policy; "
            "PSNR of the curves is over the first "
            f"{runs[0].metrics['curve_views']} of them. Time: wall clock of the episode without the evaluation, with "
            f"{comparison['workers']} jobs at a time.",
            "",
            f"Preset `{job.preset}`, sensor {_sensor(runs[0])}. {_machine(runs[0])}",
            "",
            "Every run's directory holds its configuration, numbers, decisions, path, Plane Scene Graph and map "
            "(`map.ply` opens in any Gaussian splat viewer), and its own pictures: `views.png`, `plan.png`, "
            "`psg_plan.png`, `psg_3d.png` and `phases.png`, the last with quality, holes and the terms of every "
            "choice. `results.csv` has one line per run.",
            "",
        ]
    )


def _sensor(run: Run) -> str:
    sensor = run.config["configuration"]["sensor"]
    return f"{sensor['width']} x {sensor['height']} pixels, depth noise {sensor['depth_noise']}"


def _machine(run: Run) -> str:
    hardware, versions = run.timing["hardware"], run.config["versions"]
    return (
        f"{hardware['processor']}, {hardware['cores']} cores; activestructure-gym {versions['activestructure-gym']}, "
        f"Python {versions['python']}, numpy {versions['numpy']}, numba {versions['numba']}, "
        f"embreex {versions['embreex']}."
    )
