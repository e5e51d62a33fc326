"""A finished run played again, and compared with what it stored: byte for byte, or within tolerances elsewhere.

On one kind of processor with the same versions equal jobs give equal bytes. On another kind sums are rounded otherwise,
and a decision that was close may fall the other way: there the numbers are compared, each within its tolerance.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.jobs import policy_label, refuse_code
from activestructure_gym.evaluation.archive.own_code import KEY as OWN_CODE
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.archive.verified import Verification
from activestructure_gym.evaluation.machine.hardware import code_sum, hardware
from activestructure_gym.evaluation.running.episode import Progress, run_job
from activestructure_gym.evaluation.running.remeasure import differing

# By how much a number of the same job may be another one on another processor: own choice, a third to a half of what
# two seeds differ by in docs/notebook/benchmark.md.
TOLERANCES = {
    "completion_ratio": 1.0, "tsdf_completion_ratio": 1.0, "observed": 1.0, "observed_area": 1.0, "precision": 1.0,
    "psnr": 0.5, "ssim": 0.02, "accuracy_cm": 0.2, "completion_cm": 0.5, "depth_l1_cm": 1.0,
}  # fmt: skip
# What a run stores and is decided by its job alone; the clock is not.
COMPARED = (store.CONFIG, store.METRICS, store.STEPS, store.TRAJECTORY, store.GRAPH, store.PICTURES, store.MAP)


def verify(run: Run, tell: Callable[[Progress], None] = lambda progress: None) -> Verification:
    """Check the stored files of ``run`` against their sums, play its job again, and compare.

    Raises `InputError` where the job cannot be played here: its scene or policy is not at hand or has changed, or its
    files name code that was not trusted.
    """
    here = {"processor": str(hardware()["processor"]), "code": code_sum()}
    try:
        whole = store.open_run(run.directory)
        store.read_all(whole)
        if loose := store.unsummed(whole):
            raise InputError(f"{store.DONE} has no sum of {', '.join(loose)}, which could be changed unseen")
        if untrue := untrue_evaluations(whole):
            raise InputError(f"{'; '.join(untrue)}: delete it, and `asg evaluate` measures it again")
    except InputError as error:
        return Verification("damaged", (str(error),), **here)
    if run.policy != policy_label(run.job.policy):
        raise InputError(
            f"'{run.job.policy}' was another policy's name when it was made: that one is now '{run.policy}'"
        )
    refuse_code([run.job], run.directory / store.CONFIG)
    with tempfile.TemporaryDirectory(prefix="asg-verify-") as folder:
        again = run_job(run.job, Path(folder) / "again", tell)
        others = [name for name in COMPARED if not _same(run, again, name)] + other_protocols(run, again)
        others += untrue_lpips(run, again)
        unchecked = unchecked_lpips(run, again)
        if not others:
            return Verification("identical", unchecked, **here)
        wrong = out_of_tolerance(run.metrics["metrics"], again.metrics["metrics"])
        for name in run.job.also:
            found = [one.protocols.get(name, {"metrics": {}})["metrics"] for one in (run, again)]
            wrong += [f"{name}: {text}" for text in out_of_tolerance(*found)]
        codes = [one.config["versions"].get("code") for one in (run, again)]
        if store.CONFIG in others and codes[0] == codes[1]:  # which rounds nothing
            wrong.append(f"another {store.CONFIG} of the same code")
    before, now = (one.config.get(OWN_CODE, {}) for one in (run, again))
    wrong += [f"{name} has changed since" for name, total in before.items() if now.get(name, total) != total]
    elsewhere = elsewhere_in(run, again)
    if not elsewhere:
        return Verification("differs", (f"other bytes in {', '.join(others)}", *wrong), **here)
    return Verification("differs" if wrong else "within tolerances", (*elsewhere, *wrong, *unchecked), **here)


def out_of_tolerance(stored: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Numbers that differ by more than `TOLERANCES`, in words."""
    wrong = []
    for name, most in TOLERANCES.items():
        before, now = stored.get(name), found.get(name)
        if (before is None) != (now is None) or (before is not None and not abs(now - before) <= most):
            shown = ["none" if value is None else f"{value:.2f}" for value in (before, now)]
            wrong.append(f"{name} {shown[0]}, again {shown[1]}, which may differ by {most:g}")
    return wrong


def other_protocols(run: Run, again: Run) -> list[str]:
    """The job's further protocols of which the stored numbers are others than those measured again, as files.

    What was measured later is none of the job's: `asg evaluate` says whether those numbers come out again.
    """
    wrong = []
    for name in run.job.also:
        stored, found = (one.protocols.get(name) for one in (run, again))
        if stored is None or found is None or differing(stored["metrics"], found["metrics"]):
            wrong.append(f"{store.EVALUATIONS}/{name}.json")
    return wrong


def untrue_evaluations(run: Run) -> list[str]:
    """Evaluations by the run's own protocol that say more than an LPIPS beside the run's own numbers, in words."""
    own = run.metrics["metrics"]
    found = {
        name: differing(own, content["metrics"])
        for name, content in run.evaluations.items()
        if content["protocol"]["name"] == run.job.protocol.name
    }
    return [
        f"{store.EVALUATIONS}/{name} has another {', '.join(numbers)} than metrics.json"
        for name, numbers in found.items()
        if numbers
    ]


def untrue_lpips(run: Run, again: Run) -> list[str]:
    """Files that hold another LPIPS, measured later by the run's own protocol, than is measured here."""
    found = again.metrics["metrics"].get("lpips")
    return [
        f"{store.EVALUATIONS}/{name}"
        for name, content in run.evaluations.items()
        if content["protocol"]["name"] == run.job.protocol.name
        and None not in (found, stored := content["metrics"].get("lpips"))
        and stored != found
    ]


def unchecked_lpips(run: Run, again: Run) -> tuple[str, ...]:
    """That the run stores an LPIPS which nobody can measure here, in words."""
    told = [run.metrics["metrics"].get("lpips")]
    told += [content["metrics"].get("lpips") for content in run.evaluations.values()]
    if again.metrics["metrics"].get("lpips") is not None or told == [None] * len(told):
        return ()
    return ("its LPIPS was not measured again, as the weights are not here",)


def elsewhere_in(run: Run, again: Run) -> list[str]:
    """What a run was made with that is not what this machine has, where bytes can depend on it; in words."""
    found = []
    before, now = (str(one.timing["hardware"]["processor"]) for one in (run, again))
    if before != now:
        found.append(f"made on {before}, played again on {now}")
    for name, version in run.config["versions"].items():
        other = again.config["versions"].get(name)
        if version != other and name not in ("rich", "tyro", "pillow", "matplotlib"):
            shown = [text[:12] if name == "code" else text for text in (version, str(other))]
            found.append(f"{name} was {shown[0]}, is {shown[1]}")
    return found


def _same(run: Run, again: Run, name: str) -> bool:
    if name == store.CONFIG:
        first, second = (
            {k: v for k, v in one.config.items() if k not in ("versions", OWN_CODE)} for one in (run, again)
        )
        return _without_place(first) == _without_place(second)
    if name == store.METRICS:
        own, found = run.metrics["metrics"], again.metrics["metrics"]
        same = {**run.metrics, "metrics": None} == {**again.metrics, "metrics": None} and own.keys() == found.keys()
        return same and not differing(own, found)  # which sets an LPIPS aside that only one of them has
    files = [one.directory / name for one in (run, again)]
    if not all(file.is_file() for file in files):
        return not any(file.is_file() for file in files)
    if name in run.sums and name in again.sums:
        return run.sums[name] == again.sums[name]
    return files[0].read_bytes() == files[1].read_bytes()


def _without_place(config: dict[str, Any]) -> dict[str, Any]:
    """A configuration without where the scene's file lay, whose content counts."""
    scene = {name: value for name, value in config["scene"].items() if name not in ("spec", "source", "name")}
    job = {name: value for name, value in config["job"].items() if name != "scene"}
    return {**config, "scene": scene, "job": job}
