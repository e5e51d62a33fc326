"""Write the files of a report into one directory: page, tables, images, and a summary in Markdown."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from activestructure_gym.evaluation.archive import temporary
from activestructure_gym.evaluation.archive.jobs import slug
from activestructure_gym.evaluation.archive.store import TABLES, Run
from activestructure_gym.evaluation.report.charts.convergence import chart_rows
from activestructure_gym.evaluation.report.charts.plots import standalone
from activestructure_gym.evaluation.report.charts.sweep import sweep_charts
from activestructure_gym.evaluation.report.page.convergence_section import policy_panels
from activestructure_gym.evaluation.report.page.document import html_page
from activestructure_gym.evaluation.report.page.method_text import (
    machine_text,
    metric_definitions,
    missing_value_texts,
    protocol_texts,
    statistics_text,
)
from activestructure_gym.evaluation.report.pictures.views_and_plans import compare_plans, compare_strip, compare_views
from activestructure_gym.evaluation.report.results import Results, opened, source_of
from activestructure_gym.evaluation.report.tables import verdicts
from activestructure_gym.evaluation.report.tables.columns import aspects, invalid_choices, overview_columns
from activestructure_gym.evaluation.report.tables.formats import code, documents, escaped, markdown, sentence
from activestructure_gym.evaluation.report.tables.layout import Table
from activestructure_gym.evaluation.report.tables.overview import overview, runs_csv, table_rows
from activestructure_gym.evaluation.report.tables.paper import ablation_table, tables_like_the_papers
from activestructure_gym.evaluation.report.tables.planning import planning_table
from activestructure_gym.evaluation.report.tables.published import published_tables
from activestructure_gym.evaluation.report.tables.sweep import sweep_lines, sweep_table
from activestructure_gym.evaluation.report.text_filters import without_folders

PAGE = "report.html"


def write_report(
    directory: Path, runs: Sequence[Run], comparison: Mapping[str, Any], baseline: str | None = None
) -> list[Path]:
    """Write the report of one comparison into its directory, and return the paths of the written files.

    ``comparison`` is the content of ``compare.json``. If ``baseline`` has no finished run, the default one is used.
    """
    baseline = baseline if any(baseline in (run.policy, run.planner) for run in runs) else None
    return write_results(directory, Results(runs, [source_of(directory, comparison, runs)], baseline))


def write_results(
    directory: Path, results: Results, *, published: bool = False, more: Sequence[Table] = ()
) -> list[Path]:
    """Write a report atomically, and return the paths of its files; ``summary.md`` and ``report.html`` are last.

    ``published`` adds the paper's Tables 1 and 2, with the values of these runs next to the published values. ``more``
    are further tables for the directory of tables. Raise `InputError` if a run's directory is damaged, or if
    ``directory`` cannot be written.
    """
    with temporary.atomic_files(directory) as part:
        written = _write_into(part, results, directory, published_tables(results) if published else [], more)
    return [directory / file.relative_to(part) for file in written]


def _write_into(
    part: Path, results: Results, directory: Path, published: Sequence[Table], more: Sequence[Table]
) -> list[Path]:
    """Write all files into the temporary directory ``part``; links are relative to ``directory``, the final place."""
    tables = part / TABLES
    tables.mkdir()
    written = [_written(part / "results.csv", runs_csv(results.runs))]
    for name, text in documents([*all_tables(results), *published, *more]).items():
        written.append(_written(tables / name, text))
    sections = []
    for scene, ending in zip(results.scenes, _endings(results.scenes)):
        pictures = _scene_pictures(part, results, scene, ending)
        written += pictures
        sections.append(_scene_section(results, scene, pictures, directory))
    overall = [_curves(part / "convergence.svg", results, None)] if len(results.scenes) > 1 else []
    if panels := policy_panels(results):
        title = f"One panel for each of {len(results.policies)} policies, with all others in grey"
        overall.append(_written(part / "policies.svg", standalone([[chart] for chart in panels], (), title=title)))
    if charts := sweep_charts(results):
        drawn = standalone([[chart for _, chart in charts]], [*sweep_lines(results)], title="Sweep")
        overall.insert(0, _written(part / "sweep.svg", drawn))
    if overall:
        written += overall
        shown = "\n\n".join(f"![{path.stem}](./{path.name})" for path in overall)
        sections.insert(0, f"## All scenes\n\n{shown}\n")
    written.append(_written(part / "summary.md", _summary(results, sections)))
    written.append(_written(part / PAGE, html_page(results, directory, published)))
    return written


def all_tables(results: Results) -> list[Table]:
    """Return all tables of the report except published values; tables in the layout of the paper are first."""
    tables: list[Table | None] = [*tables_like_the_papers(results), verdicts.difference_table(results)]
    tables += [verdicts.aggregate_table(results), planning_table(results)]
    tables += [verdicts.area_table(results), verdicts.cost_table(results)]
    tables.append(overview(table_rows(results.runs), overview_columns(results.runs)))
    tables.append(sweep_table(results))
    return [table for table in tables if table is not None]


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def _endings(scenes: Sequence[str]) -> list[str]:
    """Return a unique suffix for the names of each scene's image files; it is empty for a single scene."""
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


def _scene_pictures(directory: Path, results: Results, scene: str, ending: str) -> list[Path]:
    """Write the curves of a scene and the images of its `Results.foremost` runs, and return the paths.

    ``ending`` is the suffix of the file names.
    """
    shown = opened(results.foremost(scene))
    strip, views, plans = (directory / f"{name}{ending}.png" for name in ("strip", "views", "plans"))
    compare_strip(shown, title=f"{scene}, seed {shown[0].job.seed}").save(strip)
    kind = "Held-out" if shown[0].has_truth else "Captured"
    compare_views(shown, title=f"{kind} views of {scene}").save(views)
    compare_plans(shown, title=f"{scene} from above").save(plans)
    return [_curves(directory / f"convergence{ending}.svg", results, scene), strip, views, plans]


def _curves(path: Path, results: Results, scene: str | None) -> Path:
    """Write the convergence charts of ``scene``, or of all scenes for None, as one SVG; return ``path``."""
    title = f"Convergence on {scene}" if scene else f"Convergence, mean over {len(results.scenes)} scenes"
    return _written(path, standalone(chart_rows(results, scene), results.palette, title=title))


def _scene_section(results: Results, scene: str, pictures: Sequence[Path], directory: Path) -> str:
    runs = results.of(None, scene)
    info = runs[0].config["scene"]
    size = " x ".join(f"{side:.1f}" for side in info["extent_m"])
    metrics = runs[0].metrics["metrics"]
    if runs[0].has_truth:
        seen = f"{metrics['true_area_m2']:.1f} m2 of observable surface ({metrics['true_samples']:,} samples)"
        facts = [f"{info['triangles']:,} triangles, {size} m, from {info['source']}; {seen}."]
        facts += [f"Note: {note}." for note in info["notes"]]
    else:
        facts = [f"A world of {size} m without ground truth."]
    lines = [f"## {escaped(scene)}", "", *facts]
    lines = [lines[0], *(escaped(without_folders(line)) for line in lines[1:])]
    if len(kept := results.foremost(scene)) < (count := len(results.shown(scene))):
        lines += ["", f"Images of the {len(kept)} of {count} policies with the highest C.R., including the baseline; "
                  "the page has images of all."]  # fmt: skip
    for path in pictures:
        lines += ["", f"![{path.stem.partition('-')[0]}](./{path.name})"]
    return "\n".join([*lines, "", "Runs: " + ", ".join(_link(run, directory) for run in runs) + ".", ""])


def _link(run: Run, directory: Path) -> str:
    place = os.path.relpath(run.directory, directory).replace(os.sep, "/")
    return f"[{escaped(run.policy)} seed {run.job.seed}](./{quote(place)}/)"


def _summary(results: Results, sections: Sequence[str]) -> str:
    missing = [f"- {escaped(without_folders(f'{name}: {reason}'))}" for name, reason in results.missing.items()]
    collisions = sum(run.metrics["metrics"]["collisions"] or 0 for run in results.runs)
    crossed = f" Executed steps through the true mesh: {collisions}{' (must be 0!)' if collisions else ''}."
    crossed = crossed if any(run.has_truth for run in results.runs) else ""
    spread = f"Mean ± standard deviation over {results.seeds_text}" if len(results.seeds) > 1 else "One seed"
    meaning = [f"- {sentence(f'{name}: {text}')}." for name, text in metric_definitions(results).items()]
    compared: list[Table | None] = [ablation_table(results, aspect) for aspect in aspects(results.runs)]
    compared += [sweep_table(results)]
    compared += [verdicts.difference_table(results), planning_table(results), verdicts.area_table(results)]
    compared.append(verdicts.cost_table(results))
    parts = [
        "# Comparison",
        "",
        *(f"{code(without_folders(command))}\n" for source in results.sources for command in source.commands),
        f"Page with curves, images and all decisions: [{PAGE}](./{PAGE}). Tables as Markdown, CSV and LaTeX: "
        f"[{TABLES}](./{TABLES}/).",
        "",
        markdown(overview(table_rows(results.runs), overview_columns(results.runs))),
        f"{spread}; the first three of each scene are marked.{crossed}",
        "",
        *meaning,
        "",
        *(f"{sentence(text)}\n" for text in [*missing_value_texts(results), *invalid_choices(results.runs)]),
        *([f"Not finished, not counted ({len(missing)}):", "", *missing, ""] if missing else []),
    ]
    for table in compared:
        if table is not None:
            parts += [f"## {escaped(table.title)}", "", markdown(table), f"{sentence(table.caption)}.", ""]
    parts += [*sections, "## Method", "", *(f"{sentence(text)}\n" for text in protocol_texts(results))]
    for text in statistics_text():
        parts += [text, ""]
    workers = {source.workers for source in results.sources if source.workers}
    parallel = f" {' or '.join(map(str, sorted(workers)))} parallel jobs." if workers else ""
    return "\n".join(
        [
            *parts,
            sentence(machine_text(results)) + parallel,
            "",
            "Each run's directory contains its configuration, metrics, decisions, path, Plane Scene Graph and map "
            "(`map.ply` opens in any Gaussian splat viewer), and its images: `views.png`, `plan.png`, "
            "`psg_plan.png` and `psg_3d.png`. `results.csv` has one line per run.",
            "",
        ]
    )
