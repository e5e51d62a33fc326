"""Write the report's texts on the method: metrics, protocols, statistics, hardware and versions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.protocols.metrics.standard import STANDARD
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.columns import (
    aspects,
    own_metrics,
    quality_columns,
    reason_of,
    truth_absences,
    value_of,
)
from activestructure_gym.evaluation.report.text_filters import without_folders
from activestructure_gym.evaluation.statistics import intervals
from activestructure_gym.specs import Spec

_FURTHER = {  # texts on further protocols, by name
    "activegamer": (
        "Protocol `activegamer` follows the evaluation code of ActiveGAMER. Means of Gaussians are matched to the "
        "1 cm voxels of the whole surface, observable or not, so floaters do not count. Images come from one "
        "small circle of views and are masked where the true depth is missing; PSNR is computed per channel."
    ),
    "activesplat": (
        "Protocol `activesplat` follows the evaluation code of ANM-S and ActiveSplat. It ignores the map: a sample of "
        "the surface is complete if any frame saw a point within 5 cm of it, with or without a line of sight to the "
        "sample. Samples that no place 0.8 to 2 m above the ground sees are left out."
    ),
    "naruto": (
        "Protocol `naruto` follows the evaluation code of NARUTO. The surface is fused from the depth of the map. The "
        "part that the frames see is compared with the same samples as in `activesplat`."
    ),
    "offline": (
        "Protocol `offline` ignores the map of a run. It draws the keyframes without noise at their exact poses, "
        "trains a new map on them with equal iterations for every run, and measures this map "
        "with the default constants of `standard`."
    ),
}


def metric_definitions(results: Results) -> dict[str, str]:
    """Return the definition of each quality metric that has a value, by the label of the metric."""
    protocol = results.runs[0].job.conditions.protocol
    near = f"{100 * protocol.threshold_m:g} cm"
    described = {metric.name: metric for metric in (*STANDARD, *own_metrics(results.runs))}
    shown = [described[column.key] for column in quality_columns(results.runs)]
    return {metric.label: metric.meaning.replace("{near}", near) for metric in shown if metric.meaning}


def missing_value_texts(results: Results) -> list[str]:
    """Return one sentence per metric that is missing in some or all runs, with the reason.

    If no run has ground truth, return a single sentence for all metrics that need it.
    """
    if not any(run.has_truth for run in results.runs):
        return truth_absences(results.runs)
    shown = {column.key for aspect in aspects(results.runs) for column in aspect.columns}
    described = (*STANDARD, *own_metrics(results.runs))
    columns = [(metric.label, metric.name) for metric in described if not metric.name.startswith("tsdf_")] + [
        ("The TSDF surface", "tsdf_accuracy_cm")
    ]
    reasons: dict[str, list[str]] = {}
    for name in results.protocols:
        own = name == results.runs[0].job.conditions.protocol.name
        for header, metric in columns:
            key = metric if own else f"{name}/{metric}"
            found = [reason_of(run, key) for run in results.runs if value_of(run, key) is None]
            reason = next((without_folders(reason) for reason in found if reason), None)
            if reason is None:
                continue
            where = "is left out" if key not in shown else f"is missing in {len(found)} of {len(results.runs)} runs"
            reasons.setdefault(f"{header} {where}: {reason}.", []).append(name)
    several = len(results.protocols) > 1
    named = {text: f"Protocol{'s' * (len(names) > 1)} {' and '.join(names)}: " for text, names in reasons.items()}
    return [f"{protocols if several else ''}{text}" for text, protocols in named.items()]


def protocol_texts(results: Results) -> list[str]:
    """Return one paragraph per protocol of the runs, which describes how it measures."""
    return [protocol_text(results), *(text for name, text in _FURTHER.items() if name in results.protocols)]


def protocol_text(results: Results) -> str:
    """Return sentences on how the runs' own protocol measures; `metric_definitions` defines its metrics."""
    run = results.runs[0]
    protocol = run.job.conditions.protocol
    views = (
        f"{protocol.views} views drawn in free space"
        if protocol.view_source == "free_space"
        else "the views recorded with the scene"
    )
    time = "Time: wall clock of the episode without loading and evaluation."
    if not any(run.has_truth for run in results.runs):
        return (
            f"Protocol `{protocol.name}`, version {protocol.version}. There is no ground truth. The known volume "
            f"is that of the agent's grid. Image quality is measured at the keyframes, which were mapped. {time}"
        )
    return (
        f"Protocol `{protocol.name}`, version {protocol.version}. Reconstructed points are the means of Gaussians "
        f"with opacity of at least {protocol.opacity_threshold:g}. The true surface is the part visible from free "
        f"space (of {protocol.surface_samples:,} samples on the whole mesh). "
        "PSNR is pooled over the channels, the depth error is the mean absolute error. Both are measured "
        f"in {views}, {protocol.view_width} x {protocol.view_height} pixels, "
        f"{protocol.view_supersample} x {protocol.view_supersample} rays per pixel, the same for every policy. {time}"
    )


def statistics_text() -> list[str]:
    """Return the definitions of the statistics, one paragraph each."""
    return [
        "Mean: mean over scenes of the mean over runs, with equal weight per scene. Median: median over scenes of the "
        "mean over runs; with one scene, median over its runs. IQM (interquartile mean): mean of the middle half of "
        "all runs. Definitions of Agarwal et al., NeurIPS 2021 (rliable), with scenes for tasks.",
        f"Intervals: {100 * intervals.LEVEL:g} % t intervals with the degrees of freedom of Welch and Satterthwaite; "
        f"the standard error of medians and IQMs is that of {intervals.REPEATS:,} resamples. They describe the "
        "variation over seeds on these scenes, not over scenes. With one run on a scene there is no interval. A "
        "difference is significant if its interval excludes 0.",
        "Differences are paired: runs of the same scene and seed share start and sensor noise, and in the shared setup "
        "candidates. P(improvement) is the probability that a run of one policy is better than a run of the other on "
        "the same scene; runs at most half of the last printed digit apart count half. It is Mann and Whitney's U "
        "divided by the number of pairs. "
        "Intervals are not corrected for multiple comparisons.",
    ]


def machine_text(results: Results) -> str:
    """Return sentences on the preset and sensor, and on the processor and versions of the first run."""
    run = results.runs[0]
    sizes = results.each(lambda config: f"{config['sensor']['width']} x {config['sensor']['height']}")
    noises = results.each(lambda config: config["sensor"]["depth_noise"])
    hardware, versions = run.timing["hardware"], run.config["versions"]
    return (
        f"Preset `{run.job.conditions.preset}`, sensor {sizes} pixels, depth noise "
        f"{noises}. {hardware['processor']}, {hardware['cores']} cores; activestructure-gym "
        f"{versions['activestructure-gym']}, Python {versions['python']}, numpy {versions['numpy']}, numba "
        f"{versions['numba']}."
    )


def native_setup_text(results: Results) -> list[str]:
    """Return a paragraph on each policy's own settings in the native setup; empty in the shared setup."""
    if results.runs[0].job.conditions.setup == "shared":
        return []
    texts = []
    for name in results.policies:
        played = dict.fromkeys(
            _settings_text(run.config["configuration"]) for run in results.runs if run.policy == name
        )
        (policy, *_) = (run.job.policy for run in results.runs if run.policy == name)
        texts.append(f"`{name}` {', and in other runs '.join(played)}{_budget_text(policy)}")
    return [
        "Native setup: each policy uses its own candidate views and settings, with the frame budget of this "
        f"comparison. Brackets give the budget of its paper. {'; '.join(texts)}."
    ]


def _settings_text(config: Mapping[str, Any]) -> str:
    """Return the candidates, clearance, mapper and keyframes of a run's configuration as text."""
    stages = " or ".join(" + ".join(stage) for stage in config["views"]["stages"])
    every = config["keyframe_every"]
    frames = f"every {every} frames" if every <= config["frame_budget"] else "at the end of a path"
    mapper, clearance = config["mapper"], config["motion"]["candidate_clearance"]
    return (
        f"up to {config['views']['max_candidates']} views of `{stages}`, {clearance:g} m clearance, mapper "
        f"`{mapper['name']}` with {mapper['iterations']} iterations per keyframe, a keyframe {frames}"
    )


def _budget_text(policy: Spec) -> str:
    """Return the budget that the paper of a built-in policy uses, in brackets; empty if unknown."""
    from activestructure_gym.policies import POLICIES

    noted = POLICIES.get(policy.name).native_settings.budget if policy.name in POLICIES else ""
    return f" ({noted})" if noted else ""


def trajectories_text(results: Results) -> list[str]:
    """Return a sentence on runs along given trajectories; empty without such runs.

    It counts collisions, poses outside free space, and steps and turns over the limits of the planners.
    """
    texts = []
    for name in results.policies:
        runs = [run for run in results.runs if run.policy == name and run.job.policy.kind == "trajectory"]
        if not runs:
            continue
        motion = runs[0].config["configuration"].get("motion", {})
        step, turn = motion.get("max_step_m", 0.0), motion.get("max_turn_deg", 0.0)
        total = {key: sum(run.metrics["metrics"].get(key, 0) for run in runs) for key in _COUNTS}
        most = {key: max(run.metrics["metrics"].get(key, 0.0) for run in runs) for key in _MOTION_KEYS}
        texts.append(
            f"`{name}` ({total['frames']} frames) {total['collisions']} collisions, {total['poses_outside']} poses "
            f"outside free space, {total['steps_too_long']} steps over {step:g} m (largest "
            f"{most['largest_step_m']:.2f} m), {total['turns_too_wide']} turns over {turn:g} degrees (largest "
            f"{most['largest_turn_deg']:.0f}){_mapped_text(runs)}{_errors_text(runs)}"
        )
    return [f"Given trajectories, followed without planning: {'; '.join(texts)}."] if texts else []


def _mapped_text(runs: Sequence[Run]) -> str:
    """Return the number of mapped poses, with their indices if all runs have mapped the same ones."""
    keyframes = [run.trajectory["keyframes"].tolist() for run in runs]
    mapped, total = sum(map(len, keyframes)), sum(len(run.trajectory["world_from_camera"]) for run in runs)
    same = mapped < total and all(one == keyframes[0] for one in keyframes)
    shown = [*map(str, keyframes[0])]
    if len(shown) > 2 * _SHOWN:
        shown[_SHOWN:-1] = ["..."]
    return f", {mapped} of {pluralised(total, 'pose')} mapped" + (f" (from 0: {', '.join(shown)})" if same else "")


def _errors_text(runs: Sequence[Run]) -> str:
    """Return the mean errors to a reference trajectory; empty without one."""
    found = [run.metrics["metrics"] for run in runs if "ate_m" in run.metrics["metrics"]]
    if not found:
        return ""
    mean = {key: sum(one.get(key, 0.0) for one in found) / len(found) for key in _ERRORS}
    text = (
        f", ATE {mean['ate_m']:.4f} m, RPE {mean['rpe_m']:.4f} m and {mean['rpe_deg']:.3f} degrees (root mean squares, "
        f"{mean['poses_matched']:.0f} poses matched to the reference"
    )
    scale = [one["align_scale"] for one in found if "align_scale" in one]
    return text + (f", aligned with scale {sum(scale) / len(scale):.4f})" if scale else ", not aligned)")


_SHOWN = 5  # largest number of mapped poses that are listed before the last one
_ERRORS = ("ate_m", "rpe_m", "rpe_deg", "poses_matched")
_COUNTS = ("frames", "collisions", "poses_outside", "steps_too_long", "turns_too_wide")
_MOTION_KEYS = ("largest_step_m", "largest_turn_deg")


def definitions(results: Results) -> list[str]:
    """Return the paragraphs of the method section, with code between backticks."""
    return [
        *native_setup_text(results),
        *trajectories_text(results),
        *protocol_texts(results),
        *statistics_text(),
        machine_text(results),
    ]
