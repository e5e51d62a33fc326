"""A finished run on the disk that was never run: every file that is read again, made up and consistent."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.decisions import DecisionLog
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.policies.scored import Scored
from tests.evaluation.report import conftest as made_up

JOB = Job("room", "random", 0, scene_hash="ab" * 32)


def write_run(directory: Path, job: Job = JOB, *, checksums: bool = True, **numbers: Any) -> Path:
    """Write it into ``directory``, which is returned; without ``checksums`` as versions before them did."""
    run = made_up.maker(directory.parent)(job.scene, job.policy, job.seed, planes=True, **numbers)
    directory.mkdir(parents=True)
    config = {"format": store.FORMAT_VERSION, "job": job.as_dict(), "hash": job.hash, **run.config}
    views = [{"psnr": float(psnr)} for psnr in run.pictures["psnr"]]
    metrics = {
        **run.metrics["metrics"],
        "views": views,
        "keyframes": 4,
        "lpips": None,
        "notes": {"lpips": "no weights"},
    }
    points = run.metrics["curve"][1:]  # one after each decision
    counts = {"structural": 1, "objects": 1, "deficiency_centres": 1}  # of the graph
    steps = [
        {**step, "frames": point["frames"], "metres": point["metres"], "graph": {**step["graph"], **counts},
         "checkpoint": {name: point[name] for name in ("completion_ratio", "psnr")}}
        for step, point in zip(run.steps, points)
    ]  # fmt: skip
    json_files.write_json(directory / "config.json", config)
    json_files.write_json(
        directory / "metrics.json", {"format": store.FORMAT_VERSION, **run.metrics, "metrics": metrics}
    )
    json_files.write_json(directory / "timing.json", run.timing)
    (directory / store.STEPS).write_text("".join(json_files.json_line(step) for step in steps))
    camera = {"intrinsics": np.array([48.0, 48, 48, 27]), "image_size": np.array([96, 54])}
    legs = np.array([[8, points[0]["frames"], 0], [14, points[1]["frames"], 0], [20, points[2]["frames"], 0]])
    mapped = {"keyframe_rounds": np.ones(4, np.int64), "legs": legs, "max_range": np.array(10.0)}
    np.savez(directory / store.TRAJECTORY, **run.trajectory, **camera, **mapped)
    np.savez_compressed(directory / store.GRAPH, **run.graph)
    log = DecisionLog()
    for _ in steps:
        table = {"candidates": np.zeros((2, 9)), "candidate_features": np.zeros((2, 0))}
        log.add(table, 0, [Scored(0, np.array([1.0, 0.5]))])
    np.savez_compressed(directory / store.DECISIONS, **log.arrays())
    protocol = job.conditions.protocol
    shown = np.zeros((len(views), protocol.view_height, protocol.view_width, 3), np.uint8)
    np.savez_compressed(directory / store.PICTURES, **run.pictures | {"rendered": shown, "true": shown})
    GaussianMap(8).save_npz(directory / store.MAP)
    store.finish(directory, job)
    if not checksums:
        (directory / completion.DONE).write_text(job.hash + "\n")
    return directory


def write_comparison(directory: Path, jobs: list[Job], *, checksums: bool = True) -> Path:
    """A finished comparison of such runs."""
    for job in jobs:
        write_run(directory / completion.JOBS / job.name, job, checksums=checksums)
    record = {"format": store.FORMAT_VERSION, "command": "asg compare", "jobs": {j.name: j.as_dict() for j in jobs}}
    (directory / store.COMPARISON).write_text(json.dumps(record))
    return directory
