"""Texts of the page about the method: what was measured, and how the statistics are defined."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from activestructure_gym.evaluation.archive.jobs import is_trajectory
from activestructure_gym.evaluation.protocols.metrics.standard import STANDARD
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.columns import (
    aspects,
    own_metrics,
    quality_columns,
    reason_of,
    value_of,
)
from activestructure_gym.evaluation.report.text_filters import without_folders
from activestructure_gym.evaluation.statistics import resampling
from activestructure_gym.specs import Spec


def meanings(results: Results) -> dict[str, str]:
    """Explanation of each quality column, by its header."""
    protocol = results.runs[0].job.conditions.protocol
    near = f"{100 * protocol.threshold_m:g} cm"
    described = {metric.name: metric for metric in (*STANDARD, *own_metrics(results.runs))}
    shown = [described[column.key] for column in quality_columns(results.runs)]
    return {metric.label: metric.meaning.replace("{near}", near) for metric in shown if metric.meaning}


def absences(results: Results) -> list[str]:
    """Why columns were left out, or stand with gaps: one sentence each."""
    shown = {column.key for aspect in aspects(results.runs) for column in aspect.columns}
    described = (*STANDARD, *own_metrics(results.runs))
    columns = [(metric.label, metric.name) for metric in described if not metric.name.startswith("tsdf_")] + [
        ("The TSDF surface", "tsdf_accuracy_cm")
    ]
    reasons: dict[str, list[str]] = {}
    for name in results.runs[0].protocols:
        own = name == results.runs[0].job.conditions.protocol.name
        for header, metric in columns:
            key = metric if own else f"{name}/{metric}"
            found = [reason_of(run, key) for run in results.runs if value_of(run, key) is None]
            reason = next((without_folders(reason) for reason in found if reason), None)
            if reason is None:
                continue
            where = "is left out" if key not in shown else f"is missing in {len(found)} of {len(results.runs)} runs"
            reasons.setdefault(f"{header} {where}: {reason}.", []).append(name)
    several = len(results.runs[0].protocols) > 1
    return [f"Protocol {' and '.join(names)}: {text}" if several else text for text, names in reasons.items()]


def protocol_texts(results: Results) -> list[str]:
    """The protocols in words."""
    texts = [protocol_text(results)]
    if "activegamer" in results.runs[0].protocols:
        texts.append(
            "Protocol `activegamer` follows the evaluation code of ActiveGAMER: means matched to the 1 cm voxels of "
            "the whole surface, seen or not, so that floaters do not count; images masked where the truth has no "
            "depth, from one small circle of views; PSNR by channel."
        )
    return texts


def protocol_text(results: Results) -> str:
    """How the protocol measures, in sentences; `meanings` explains its numbers."""
    run = results.runs[0]
    protocol = run.job.conditions.protocol
    views = (
        f"{protocol.views} views drawn in free space"
        if protocol.view_source == "free_space"
        else "the views recorded with the scene"
    )
    return (
        f"Protocol `{protocol.name}`, version {protocol.version}. Reconstructed points are the means of Gaussians "
        f"with opacity of at least {protocol.opacity_threshold:g}; the truth is the surface that some free pose "
        f"can see (those of {protocol.surface_samples:,} samples on the whole mesh that are seen). "
        "Images are compared (PSNR pooled over the channels, depth by its mean absolute error) "
        f"in {views}, {protocol.view_width} x {protocol.view_height} pixels, "
        f"{protocol.view_supersample} x {protocol.view_supersample} rays per pixel, the same for every policy. "
        "Time: wall clock of the episode without loading and evaluation."
    )


def statistics_text() -> list[str]:
    """The statistics in words, a paragraph each."""
    level = f"{100 * resampling.LEVEL:g} %"
    return [
        "Means: over the scenes of the mean over their runs, so that every scene counts the same. Median: over the "
        "scenes of the mean over their runs; with one scene, over its runs. IQM, the interquartile mean: of the middle "
        "half of all runs. Definitions of Agarwal et al., NeurIPS 2021 (rliable), with scenes for tasks.",
        f"Intervals: {level} percentile bootstrap, {resampling.REPEATS:,} resamples, stratified: every scene's runs "
        "are drawn again with replacement, the scenes stay. They say how much other seeds could change the result on "
        "these scenes, not on others. With few seeds they are too narrow, by about the square root of (n - 1) / n for "
        "n seeds; with one run on a scene there is none.",
        "Differences are paired: runs of the same scene and seed share start, sensor noise and candidates. "
        "P(improvement) is the probability that a run of one policy is better than a run of the other on the same "
        "scene, ties (what is printed alike) counted half: Mann and Whitney's U over the number of pairs. Several "
        "metrics and policies are tested at once and no interval is widened for that.",
    ]


def machine_text(results: Results) -> str:
    """Sensor, processor and the versions that decide numbers."""
    run = results.runs[0]
    sensor = run.config["configuration"]["sensor"]
    hardware, versions = run.timing["hardware"], run.config["versions"]
    return (
        f"Preset `{run.job.conditions.preset}`, sensor {sensor['width']} x {sensor['height']} pixels, depth noise "
        f"{sensor['depth_noise']}. {hardware['processor']}, {hardware['cores']} cores; activestructure-gym "
        f"{versions['activestructure-gym']}, Python {versions['python']}, numpy {versions['numpy']}, numba "
        f"{versions['numba']}, embreex {versions['embreex']}."
    )


def terms_text(results: Results) -> list[str]:
    """What every policy brought, where they are compared on their own terms."""
    if results.runs[0].job.conditions.setup == "shared":
        return []
    told = []
    for name in results.policies:
        played = dict.fromkeys(_schedule(run.config["configuration"]) for run in results.runs if run.policy == name)
        told.append(f"`{name}` {', and in other runs '.join(played)}{_budget(name)}")
    return [
        "Native setup: every policy with candidate views and a schedule of its own, at the budget of this comparison; "
        f"in brackets what its paper spends. {'; '.join(told)}."
    ]


def _schedule(config: Mapping[str, Any]) -> str:
    """What a run was played with, by its configuration."""
    stages = " or ".join(" + ".join(stage) for stage in config["views"]["stages"])
    every = config["keyframe_every"]
    frames = f"every {every} frames" if every <= config["frame_budget"] else "at the end of a way"
    mapper, clearance = config["mapper"], config["motion"]["candidate_clearance"]
    return (
        f"up to {config['views']['max_candidates']} views of `{stages}`, {clearance:g} m from what is not free, mapper "
        f"`{mapper['name']}` with {mapper['iterations']} iterations for a keyframe {frames}"
    )


def _budget(name: str) -> str:
    """What the paper of a policy that ships spends, in brackets."""
    from activestructure_gym.policies import POLICIES

    plain = Spec.of(name).name
    noted = POLICIES.get(plain).native_settings.budget if plain in POLICIES else ""
    return f" ({noted})" if noted else ""


def trajectories_text(results: Results) -> list[str]:
    """What trajectories that were given did beside the limits that planners keep, where there are any."""
    told = []
    for name in results.policies:
        runs = [run for run in results.runs if run.policy == name and is_trajectory(run.job.policy)]
        if not runs:
            continue
        motion = runs[0].config["configuration"].get("motion", {})
        step, turn = motion.get("max_step_m", 0.0), motion.get("max_turn_deg", 0.0)
        total = {key: sum(run.metrics["metrics"].get(key, 0) for run in runs) for key in _BESIDE}
        most = {key: max(run.metrics["metrics"].get(key, 0.0) for run in runs) for key in _MOTION_KEYS}
        told.append(
            f"`{name}` ({total['frames']} frames) {total['collisions']} collisions, {total['poses_outside']} poses "
            f"outside of the free space, {total['steps_too_long']} steps over {step:g} m (largest "
            f"{most['largest_step_m']:.2f} m), {total['turns_too_wide']} turns over {turn:g} degrees (largest "
            f"{most['largest_turn_deg']:.0f})"
        )
    return [f"Given trajectories, which were followed and not planned: {'; '.join(told)}."] if told else []


_BESIDE = ("frames", "collisions", "poses_outside", "steps_too_long", "turns_too_wide")
_MOTION_KEYS = ("largest_step_m", "largest_turn_deg")


def definitions(results: Results) -> list[str]:
    """All texts of this module, a paragraph each; code stands between backticks."""
    return [
        *terms_text(results),
        *trajectories_text(results),
        *protocol_texts(results),
        *statistics_text(),
        machine_text(results),
    ]
