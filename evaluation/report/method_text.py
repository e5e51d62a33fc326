"""The words that stand below the numbers: what was measured, and how the statistics are defined."""

from __future__ import annotations

from activestructure_gym.evaluation.report.html import Html, element
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.statistics import resampling


def protocol_texts(results: Results) -> list[str]:
    """The protocols in words, and why numbers are missing."""
    texts = [protocol_text(results)]
    if "activegamer" in results.runs[0].protocols:
        texts.append(
            "Protocol `activegamer` follows the evaluation code of ActiveGAMER (docs/protocols.md): means matched to "
            "the 1 cm voxels of the whole surface, seen or not, so that floaters do not count; images masked where the "
            "truth has no depth, from one small circle of views; PSNR by channel."
        )
    reasons: dict[str, None] = {}
    for run in results.runs:
        for name, content in run.protocols.items():
            for key, reason in (content["metrics"].get("notes") or {}).items():
                reasons[f"{key} is not defined in protocol `{name}`: {reason}."] = None
    return [*texts, *reasons]


def protocol_text(results: Results) -> str:
    """The metrics of the protocol in words."""
    run = results.runs[0]
    protocol = run.job.protocol
    views = (
        f"{protocol.views} views drawn in free space"
        if protocol.view_source == "free_space"
        else "the views recorded with the scene"
    )
    return (
        f"Protocol `{protocol.name}`, version {protocol.version}. Reconstructed points are the means of Gaussians "
        f"with opacity of at least {protocol.opacity_threshold:g}; the truth is the surface that some free pose "
        f"can see (those of {protocol.surface_samples:,} samples on the whole mesh that are seen). "
        "Acc: mean distance from the points to that surface. "
        "Com.: mean distance from the surface to the points. C.R. and Prec.: shares of surface and of points "
        f"nearer than {100 * protocol.threshold_m:g} cm; F: their harmonic mean. PSNR (pooled over the channels), SSIM "
        f"and Depth (mean absolute error): means over {views}, {protocol.view_width} x {protocol.view_height} pixels, "
        f"{protocol.view_supersample} x {protocol.view_supersample} rays per pixel, the same for every policy; PSNR of "
        f"the curves is over the first {run.metrics['curve_views']} of them. Time: wall clock of the episode without "
        "loading and evaluation."
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
        "scene, ties counted half: Mann and Whitney's U over the number of pairs. Several metrics and policies are "
        "tested at once and no interval is widened for that.",
    ]


def machine_text(results: Results) -> str:
    """Sensor, processor and the versions that decide numbers."""
    run = results.runs[0]
    sensor = run.config["configuration"]["sensor"]
    hardware, versions = run.timing["hardware"], run.config["versions"]
    return (
        f"Preset `{run.job.preset}`, sensor {sensor['width']} x {sensor['height']} pixels, depth noise "
        f"{sensor['depth_noise']}. {hardware['processor']}, {hardware['cores']} cores; activestructure-gym "
        f"{versions['activestructure-gym']}, Python {versions['python']}, numpy {versions['numpy']}, numba "
        f"{versions['numba']}, embreex {versions['embreex']}."
    )


def definitions(results: Results) -> list[Html]:
    """All of it as paragraphs."""
    texts = [*protocol_texts(results), *statistics_text(), machine_text(results)]
    return [_paragraph(text) for text in texts]


def _paragraph(text: str) -> Html:
    parts = text.split("`")
    return element("p", *(element("code", part) if k % 2 else part for k, part in enumerate(parts)))
