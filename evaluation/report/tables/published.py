"""Compare the runs of a report with the published values of the paper's Tables 1 and 2.

Rows "published" are copied from [activestructure]. Its authors took the values of other systems from papers, or ran
these systems. Rows "here" are runs of this package. Runs on other scenes are labelled "another dataset", since values
of different scenes are not comparable.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.columns import QUALITY, Aspect, Column, aspects, value_of
from activestructure_gym.evaluation.report.tables.layout import MISSING, Cell, Heading, Table, number, with_interval
from activestructure_gym.evaluation.statistics import estimate
from activestructure_gym.scenes.datasets import MATTERPORT3D, REPLICA, Dataset
from activestructure_gym.specs import Spec

_KEYS = {
    "Acc": "accuracy_cm",
    "Com.": "completion_cm",
    "C.R.": "completion_ratio",
    "PSNR": "psnr",
    "SSIM": "ssim",
    "LPIPS": "lpips",
}
_DIGITS = {"C.R.": 2}  # decimals that differ from those of `Column`, as in the paper
_COLUMNS = {
    name: replace(column, digits=_DIGITS.get(name, column.digits))
    for name, key in _KEYS.items()
    for column in QUALITY
    if column.key == key
}

# Name in this package by the name of the system in the tables: policies, and mappers for systems that do not plan.
_ACTIVE = {
    "ActiveINR": "activeinr",
    "ANM-S": "anm_s",
    "NARUTO": "naruto",
    "ActiveGAMER": "activegamer",
    "ActiveSplat": "activesplat",
    "ActiveStructure": "activestructure",
}
_PASSIVE = {"Co-SLAM": "co_slam", "MonoGS": "monogs", "SplaTAM": "splatam", "Gaussian-SLAM": "gaussian_slam"}

# A column per scene in the order of `Dataset.scenes`, then the average as printed. "-": not completed in five trials.
_TABLE_1 = """
ActiveINR
    Acc     1.36   1.27   1.66  11.23   3.59   1.77   5.31   1.21   3.43
    Com.    7.69   7.76   7.04  14.17  12.06   6.87  11.73   4.85   9.02
    C.R.   72.18  70.84  67.34  31.53  49.00  70.61  39.00  80.68  60.15
ANM-S
    Acc     1.44   1.03   1.60   1.80   1.50   1.47   1.29   1.28   1.43
    Com.    1.98   1.55   6.65   1.13   1.08   0.91   1.02   0.85   1.90
    C.R.   95.43  92.66  79.20  94.98  95.35  96.71  95.66  96.79  93.35
Co-SLAM
    Acc     1.28   1.02   2.09   2.24   1.65   1.55   1.24   1.37   1.56
    Com.    9.97   9.21   5.29   3.85   4.42   3.56   3.26   4.71   5.53
    C.R.   80.42  78.12  82.20  84.50  83.89  88.49  88.65  84.44  83.84
    PSNR   19.80  20.12  13.37  13.45  14.44  17.23  18.62  15.42  16.56
    SSIM   0.609  0.619  0.468  0.418  0.451  0.491  0.551  0.481  0.511
    LPIPS  0.668  0.626  0.705  0.774  0.766  0.733  0.690  0.716  0.710
MonoGS
    Acc     2.72   4.87   3.88   3.89   3.73   3.49   3.92   3.98   3.81
    Com.   10.36  10.27   7.12   5.23   5.71   4.86   4.75   7.52   6.98
    C.R.   77.89  64.87  70.65  73.56  72.36  78.47  77.04  70.76  73.20
    PSNR   31.28  32.89  24.26  26.27  30.03  34.21  32.06  23.21  29.28
    SSIM   0.931  0.942  0.907  0.933  0.965  0.964  0.944  0.924  0.939
    LPIPS  0.082  0.095  0.129  0.087  0.056  0.047  0.067  0.113  0.085
SplaTAM
    Acc     1.01   0.88   1.43   1.61   1.49   1.46   1.08   1.23   1.27
    Com.   10.07   9.24   5.26   3.63   3.83   3.57   3.26   4.17   5.38
    C.R.   81.27  78.68  83.61  86.25  86.69  88.66  88.61  87.55  85.17
    PSNR   29.59  30.80  23.56  26.29  30.57  28.93  28.24  20.66  27.33
    SSIM   0.947  0.959  0.929  0.946  0.977  0.946  0.956  0.911  0.946
    LPIPS  0.134  0.156  0.194  0.189  0.108  0.156  0.113  0.182  0.154
NARUTO
    Acc     1.28   1.03      -   2.79   1.65   1.56      -   1.50      -
    Com.    1.41   1.20      -   2.41   1.97   1.82      -   1.47      -
    C.R.   97.57  97.75      -  91.75  95.21  96.97      -  98.79      -
    PSNR   31.61  34.31      -  26.45  26.47  26.45      -  25.15      -
    SSIM   0.903  0.923      -  0.835  0.878  0.801      -  0.750      -
    LPIPS  0.169  0.117      -  0.204  0.180  0.219      -  0.283      -
ActiveGAMER
    Acc     0.97   0.87   1.37   1.49   1.51   1.54   1.19   1.26   1.28
    Com.    1.16   1.07   2.35   2.09   1.97   2.06   1.57   1.62   1.74
    C.R.   98.23  98.42  96.87  96.24  94.72  93.96  97.12  97.17  96.59
    PSNR   34.41  34.79  28.73  31.94  31.08  27.97  28.66  30.37  30.99
    SSIM   0.975  0.967  0.964  0.968  0.974  0.931  0.939  0.963  0.960
    LPIPS  0.101  0.140  0.154  0.084  0.118  0.217  0.171  0.113  0.137
ActiveSplat
    Acc     1.16   1.11   1.47   1.70   1.50   1.67   1.43   1.36   1.43
    Com.    0.63   0.94   5.59   1.83   1.06   0.84   0.74   1.04   1.58
    C.R.   97.54  94.54  80.69  91.49  95.34  97.04  96.84  95.65  93.64
    PSNR   23.79  26.42  22.22  20.96  22.89  26.36  26.39  28.71  24.72
    SSIM   0.841  0.864  0.881  0.804  0.866  0.830  0.878  0.870  0.854
    LPIPS  0.162  0.129  0.116  0.232  0.275  0.195  0.137  0.116  0.170
ActiveStructure
    Acc     0.91   0.81   1.22   1.32   1.31   1.33   1.16   1.19   1.16
    Com.    1.02   1.04   1.65   2.21   1.67   1.74   1.42   1.21   1.49
    C.R.   98.48  98.59  96.58  95.05  96.86  96.75  98.17  99.26  97.47
    PSNR   35.77  36.47  30.94  29.93  33.80  28.82  29.84  31.49  32.13
    SSIM   0.980  0.975  0.976  0.969  0.985  0.942  0.985  0.982  0.974
    LPIPS  0.084  0.115  0.115  0.127  0.074  0.174  0.148  0.089  0.116
"""
_TABLE_2 = """
ActiveINR
    Acc     5.09   4.15  15.60   5.56   8.61   7.80
    Com.    5.69   7.43  15.96   8.03   8.46   9.11
    C.R.   80.99  80.68  48.34  76.41  79.35  73.15
ANM-S
    Acc     5.52   1.62   2.13   4.54   4.50   3.66
    Com.    3.95   2.01  12.49   2.51   3.53   4.90
    C.R.   91.00  94.58  60.39  95.02  88.65  85.93
MonoGS
    Acc     3.71   7.69   5.44   2.14   3.17   4.43
    Com.   11.93   8.45  19.44  57.92 121.41  43.83
    C.R.   60.23  48.93  57.14  53.01  47.58  53.38
SplaTAM
    Acc     2.17   2.98   3.07   4.88   4.11   3.44
    Com.   10.87   5.17  22.92  61.77 111.52  42.45
    C.R.   68.11  76.31  50.87  46.00  43.69  57.00
Gaussian-SLAM
    Acc     2.63   3.42   2.54   3.77   4.32   3.34
    Com.   12.41   5.87  22.71   6.42  19.41  13.36
    C.R.   66.24  76.11  62.51  73.88  56.43  67.03
NARUTO
    Acc     2.34   3.57   7.29   4.46   9.52   5.44
    Com.    4.93   2.47   2.84   3.14   5.68   3.81
    C.R.   84.88  93.26  92.15  82.67  78.99  86.39
    PSNR   22.27  21.98  21.96  22.20  19.72  21.63
    SSIM   0.642  0.596  0.668  0.548  0.558  0.602
    LPIPS  0.461  0.463  0.440  0.536  0.493  0.479
ActiveGAMER
    Acc     1.26   1.42   1.31   2.15   2.03   1.63
    Com.    1.63   1.63   1.62   2.38   5.43   2.54
    C.R.   96.85  97.85  96.72  93.37  88.35  94.63
    PSNR   26.56  26.54  25.71  26.42  21.93  25.43
    SSIM   0.939  0.949  0.911  0.916  0.847  0.912
    LPIPS  0.223  0.224  0.290  0.315  0.374  0.285
ActiveSplat
    Acc     2.39   1.74   2.53   4.09   9.52   4.05
    Com.    3.76   1.34  24.28   1.07   2.84   6.66
    C.R.   92.11  97.61  44.45  99.10  90.78  84.81
    PSNR   22.77  19.03  19.07  23.49  24.57  21.79
    SSIM   0.700  0.688  0.780  0.667  0.852  0.737
    LPIPS  0.264  0.273  0.227  0.345  0.156  0.253
ActiveStructure
    Acc     1.17   1.37   1.25   2.04   2.00   1.57
    Com.    1.35   1.57   1.56   2.33   2.74   1.91
    C.R.   98.53  97.95  96.56  96.21  91.91  96.23
    PSNR   27.42  27.19  26.72  26.85  22.23  26.08
    SSIM   0.951  0.958  0.928  0.928  0.837  0.920
    LPIPS  0.182  0.186  0.215  0.300  0.396  0.256
"""


@dataclass(frozen=True)
class Published:
    """Hold one of the paper's tables."""

    number: int
    dataset: Dataset
    values: dict[str, dict[str, tuple[float | None, ...]]]  # by system and metric: a value per scene, then the average


def _read(text: str) -> dict[str, dict[str, tuple[float | None, ...]]]:
    found: dict[str, dict[str, tuple[float | None, ...]]] = {}
    for line in text.strip().splitlines():
        if not line.startswith(" "):
            own = found.setdefault(line, {})
            continue
        metric, *values = line.split()
        own[metric] = tuple(None if value == "-" else float(value) for value in values)
    return found


PUBLISHED = (Published(1, REPLICA, _read(_TABLE_1)), Published(2, MATTERPORT3D, _read(_TABLE_2)))


def published_tables(results: Results) -> list[Table]:
    """Return Tables 1 and 2 with published values and the values of these runs: each as averages, then by scene."""
    return [make(table, results) for table in PUBLISHED for make in (averages_table, scenes_table)]


def averages_table(published: Published, results: Results) -> Table:
    """Return a table of averages: per system a published row, then rows of its runs; other policies are last."""
    aspect = _aspect(results)
    columns = _columns(aspect)
    own = _of_dataset(results, published.dataset)
    runs, other = (own, False) if own else (results.runs, True)
    rows: list[list[Cell]] = []
    blocks: list[int] = []

    def here(system: str, kind: str, name: str) -> None:
        mine = [run for run in runs if _name_here(run) == name and _is_passive(run) == (kind == "passive")]
        for policy in dict.fromkeys(run.policy for run in mine):
            group = [run for run in mine if run.policy == policy]
            where = _where(group, None if other else published.dataset)
            rows.append([Cell(system), Cell(kind), Cell(f"here: {policy}"), Cell(where), *_means(group, columns)])

    for system, values in published.values.items():
        kind = "passive" if system in _PASSIVE else "active"
        if rows:
            blocks.append(len(rows))
        count = sum(value is not None for value in values["C.R."][:-1])
        where = f"{count} of {published.dataset.title}"
        cells = [number(values[name][-1] if name in values else None, c.digits, MISSING) for name, c in columns.items()]
        rows.append([Cell(system), Cell(kind), Cell("published"), Cell(where), *cells])
        here(system, kind, (_PASSIVE if kind == "passive" else _ACTIVE)[system])
    known = {(system in _PASSIVE, {**_ACTIVE, **_PASSIVE}[system]) for system in published.values}  # in the table
    others = [run for run in runs if (_is_passive(run), _name_here(run)) not in known]
    for policy in dict.fromkeys(run.policy for run in others):
        blocks.append(len(rows))
        group = [run for run in others if run.policy == policy]
        kind = "passive" if _is_passive(group[0]) else "active"
        kind = "reference" if group[0].job.policy.kind == "reference" else kind
        where = _where(group, None if other else published.dataset)
        rows.append([Cell(policy), Cell(kind), Cell("here"), Cell(where), *_means(group, columns)])
    headings = [Heading(text, numeric=False) for text in ("System", "Kind", "Values", "Scenes")]
    headings += [Heading.of(column) for column in columns.values()]
    caption = (
        f"Published: averages of the paper's Table {published.number} with 2000 frames per scene, C.R. at 5 cm and "
        f"the novel views of ActiveGAMER. \u201c{MISSING}\u201d: not completed on every scene, or not reported. "
        f"Here: {_conditions(results, aspect)}; means over scenes "
        "of means over runs, with 95 % intervals if every scene has several runs"
    )
    if other:
        caption += ". None of these runs is on a scene of this table: all rows \u201chere\u201d are of another dataset"
    else:
        caption += f". {_by_name(published.dataset)}"
    title = f"Table {published.number} of the paper, {published.dataset.title}, averages"
    return Table(f"published-{published.number}", title, headings, rows, caption, blocks=blocks)


def scenes_table(published: Published, results: Results) -> Table:
    """Return a table as in the paper: a row per system and metric, and a column per scene.

    Rows of runs on these scenes follow.
    """
    aspect = _aspect(results)
    columns = _columns(aspect)
    titles, folders = list(published.dataset.scenes), list(published.dataset.scenes.values())
    own = _of_dataset(results, published.dataset)
    rows: list[list[Cell]] = []
    blocks: list[int] = []

    def add(name: str, values: dict[str, Sequence[float | None]]) -> None:
        if rows:
            blocks.append(len(rows))
        for metric, row in values.items():
            column = columns.get(metric, _COLUMNS[metric])
            cells = [number(value, column.digits, MISSING) for value in row]
            rows.append([Cell(name), Cell(column.title), *cells])

    for system, values in published.values.items():
        add(f"{system}, published", dict(values))
    for policy in dict.fromkeys(run.policy for run in own):
        found: dict[str, Sequence[float | None]] = {}
        for metric, column in columns.items():
            means = [
                _mean(
                    [run for run in own if run.policy == policy and _folder(run, published.dataset) == folder], column
                )
                for folder in folders
            ]
            whole = [value for value in means if value is not None]
            found[metric] = [*means, float(np.mean(whole)) if len(whole) == len(means) else None]
        add(f"{policy}, here", found)
    headings = [Heading("Method", numeric=False), Heading("Metric", numeric=False)]
    headings += [Heading(text) for text in (*titles, "Avg.")]
    caption = f"\u201c{MISSING}\u201d: not completed (published), no run (here)"
    caption += (
        f". Here: {_conditions(results, aspect)}. {_by_name(published.dataset)}"
        if own
        else ". No run here is on one of these scenes"
    )
    title = f"Table {published.number} of the paper, {published.dataset.title}, by scene"
    return Table(f"published-{published.number}-scenes", title, headings, rows, caption, blocks=blocks)


def _aspect(results: Results) -> Aspect:
    """Return the aspect that is closest to the paper's evaluation: protocol activegamer if measured, else the first."""
    found = aspects(results.runs)
    return next((aspect for aspect in found if aspect.title == "activegamer"), found[0])


def _columns(aspect: Aspect) -> dict[str, Column]:
    """Return the metrics of the paper's tables as columns of ``aspect``, by the name of the metric in the paper."""
    prefix = f"{aspect.name}/" if aspect.name else ""
    return {name: replace(column, key=f"{prefix}{column.key}") for name, column in _COLUMNS.items()}


def _is_passive(run: Run) -> bool:
    return run.job.policy.kind == "trajectory"


def _name_here(run: Run) -> str:
    """Return the name that identifies the system of a run: its mapper for a given trajectory, else its policy."""
    if _is_passive(run):
        return str(run.config["configuration"]["mapper"]["name"])
    return run.job.policy.name


def _folder(run: Run, dataset: Dataset) -> str | None:
    """Return the folder name of a run's scene in ``dataset``; None if the scene does not belong to the dataset."""
    kind, colon, place = run.job.scene.partition(":")
    name = (Spec(place) if colon and kind == dataset.kind else run.job.scene).name.rstrip("/")
    parts = [part for part in re.split(r"[/\\]", name) if part not in ("habitat", "mesh.ply", "mesh_semantic.ply")]
    last = parts[-1].removesuffix(".glb") if parts else ""
    return dataset.folder_of(last) if colon and kind == dataset.kind or last in dataset.scenes.values() else None


def _by_name(dataset: Dataset) -> str:
    """Return a sentence which says that scenes are matched by name, without a check of their files."""
    return f"Runs are assigned to {dataset.title} by their scene's name alone; the scenes' files were not checked"


def _of_dataset(results: Results, dataset: Dataset) -> list[Run]:
    return [run for run in results.runs if _folder(run, dataset) is not None]


def _where(runs: Sequence[Run], dataset: Dataset | None) -> str:
    """Return the scenes of the runs in a row as text; None as ``dataset`` means another dataset."""
    if dataset is not None:
        return f"{len({_folder(run, dataset) for run in runs})} of {dataset.title}"
    scenes = list(dict.fromkeys(run.scene for run in runs))
    named = ", ".join(scenes) if len(scenes) <= 2 else f"{len(scenes)} scenes"
    return f"another dataset: {named}"


def _means(runs: Sequence[Run], columns: dict[str, Column]) -> Iterator[Cell]:
    """Yield a cell per column: the mean over the scenes of the means over their runs, with its interval."""
    for column in columns.values():
        strata = []
        for scene in dict.fromkeys(run.scene for run in runs):
            values = [value_of(run, column.key) for run in runs if run.scene == scene]
            strata.append(np.array([value for value in values if value is not None]))
        if not strata or any(len(stratum) == 0 for stratum in strata):
            yield Cell(MISSING)
        else:
            yield with_interval(estimate(strata), column)


def _mean(runs: Sequence[Run], column: Column) -> float | None:
    values = [value for run in runs if (value := value_of(run, column.key)) is not None]
    return float(np.mean(values)) if values else None


def _conditions(results: Results, aspect: Aspect) -> str:
    """Return the frame budget, the image size and the protocol of the runs as text."""
    sizes = results.each(lambda config: f"{config['sensor']['width']} x {config['sensor']['height']}")
    budgets = results.each(lambda config: str(config["frame_budget"]))
    return f"{budgets} frames of {sizes} pixels, protocol {aspect.title}"
