"""Verify a finished run: play its job again and compare the result with the stored files.

Equal jobs give equal bytes with the same processor model and package versions. So equal bytes confirm a run, and
different bytes refute it if processor and versions are the same. With another processor or other versions, different
bytes decide nothing: rounding differs, and a close decision may change. Such a run is refuted only if its own files
contradict each other. The processor and the versions are read from the run itself, so they never confirm it.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.jobs import refuse_code
from activestructure_gym.evaluation.archive.plugin_code import KEY as OWN_CODE
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.metrics.planning import planning_scores
from activestructure_gym.evaluation.protocols import protocol_from
from activestructure_gym.evaluation.reproduction.remeasure import differing, measure_again, protocols_of, without_lpips
from activestructure_gym.evaluation.running.episode import Progress, run_job
from activestructure_gym.worlds import StoredCaptures

# Files that depend only on the job. Times are not compared. Images and pages are not compared either, because they are
# drawn from these files.
COMPARED = (store.CONFIG, store.METRICS, store.STEPS, store.TRAJECTORY, store.GRAPH, store.PICTURES, store.MAP,
            store.PLY, store.DECISIONS)  # fmt: skip
# Tolerances between the numbers of one map on two processors: own choice, far above rounding. So agreement within them
# does not confirm a run.
_CLOSE, _CLOSE_TO_0 = 5e-3, 1e-2  # relative, absolute
_MAX_NAMED = 5  # maximum number of metrics listed in a message; metrics in `_LEADING` come first
_LEADING = ("tsdf_completion_ratio", "completion_ratio", "observed_area", "psnr")
_SHOWING = ("rich", "tyro", "pillow")  # packages for output and images, which affect no number

Verdict = Literal["identical", "not comparable here", "differs", "damaged"]
REFUTED: tuple[Verdict, ...] = ("differs", "damaged")


@dataclass(frozen=True)
class Verification:
    """Hold the verdict on a run that was played again, and the reasons."""

    verdict: Verdict
    why: tuple[str, ...] = ()  # sentences on differences of files, processor and versions


def verify(run: Run, notify: Callable[[Progress], None] = lambda progress: None) -> Verification:
    """Compare the files of a run with their checksums, play its job again, and compare the results.

    ``notify`` is called with the progress of the new episode. Raise `InputError` if the job cannot be played here: its
    scene or policy is missing or has changed, or its files name code that is not trusted.
    """
    try:
        run = store.open_run(run.directory, run.scene)
        store.read_all(run)
        if loose := store.without_checksum(run):
            raise InputError(f"{completion.DONE} has no checksum of {', '.join(loose)}: a change would not be detected")
        if untrue := altered_evaluations(run):
            raise InputError(f"{'; '.join(untrue)}: delete it, and `asg evaluate` measures it again")
    except InputError as error:
        return Verification("damaged", (str(error),))
    refuse_code([run.job], run.directory / store.CONFIG)
    with tempfile.TemporaryDirectory(prefix="asg-verify-") as folder:
        captures = run.directory / store.CAPTURES
        world = StoredCaptures(captures) if captures.is_dir() else None
        again = run_job(run.job, Path(folder) / "again", notify, world=world)
        evaluations, missing = remeasured_evaluations(run, again)
        others = [name for name in COMPARED if not _same(run, again, name)] + evaluations
    if not others:
        return Verification("not comparable here" if missing else "identical", tuple(missing))
    difference = f"other bytes in {', '.join(others)}"
    elsewhere = environment_differences(run, again) + missing
    if not elsewhere:
        return Verification("differs", (difference, *numbers_that_differ(run, again)))
    codes = [one.config["versions"].get("code") for one in (run, again)]
    wrong = [f"another {store.CONFIG} of the same code"] if store.CONFIG in others and codes[0] == codes[1] else []
    if wrong := [*wrong, *contradictions(run)]:
        return Verification("differs", (difference, *wrong))
    return Verification("not comparable here", (*elsewhere, difference, *numbers_that_differ(run, again)))


def numbers_that_differ(run: Run, again: Run) -> list[str]:
    """Return texts on up to 5 metrics (`_MAX_NAMED`) that differ between the stored ``run`` and ``again``."""
    stored, found = (one.metrics["metrics"] for one in (run, again))
    names = dict.fromkeys((*_LEADING, *found, *stored))
    return _first(
        f"{name} {_shown(stored.get(name))}, again {_shown(found.get(name))}"
        for name in names
        if not name.startswith("lpips") and _is_scalar(stored.get(name)) and stored.get(name) != found.get(name)
    )


def contradictions(run: Run) -> list[str]:
    """Return texts on stored metrics that contradict the run's own map, trajectory and curve.

    The stored map is measured again on this machine. No episode is played, so the run may be of any processor.
    """
    planned, _ = planning_scores(run.metrics["curve"], run.config["configuration"]["frame_budget"])
    wrong = []
    with suppress(InputError):  # this version does not have the protocol
        for protocol, stored in protocols_of(run):
            stored = stored or {}
            own = protocol.name == run.job.conditions.protocol.name
            measured = measure_again(run, protocol) | (planned if own else {})
            wrong += [
                f"{protocol.name}: {name} is {_shown(stored[name])}, and {_shown(value)} by the run's own map and curve"
                for name, value in measured.items()
                if name in stored and not name.startswith("lpips") and _is_scalar(value)
                and not _is_close(stored[name], value)
            ]  # fmt: skip
    return _first(wrong)


def altered_evaluations(run: Run) -> list[str]:
    """Return texts on evaluations by the protocol of the job that differ from the run's metrics in more than LPIPS."""
    own, parameters = run.metrics["metrics"], json_files.plain(run.job.conditions.protocol.parameters())
    wrong = []
    for name, content in run.evaluations.items():
        if content["protocol"]["name"] != run.job.conditions.protocol.name:
            continue
        numbers = differing(own, content["metrics"])
        if numbers or content["protocol"] != parameters:
            other = ", ".join(numbers) or "protocol"
            wrong.append(f"{store.EVALUATIONS}/{name} has another {other} than {store.METRICS}")
    return wrong


def remeasured_evaluations(run: Run, again: Run) -> tuple[list[str], list[str]]:
    """Compare the stored evaluations of ``run`` with those of ``again``, the same job played again.

    If ``again`` has no evaluation by a protocol, its map is measured by this protocol now. Return the evaluation files
    whose numbers differ, and texts on numbers that cannot be measured here: LPIPS without its weights, and protocols
    that this version does not have.
    """
    wrong, unknown = [name for name in again.evaluations if name not in run.evaluations], []
    own, found = run.metrics["metrics"], again.metrics["metrics"]
    pairs = [(own, found)]
    for name, content in run.evaluations.items():
        stored, parameters = content["metrics"], content["protocol"]
        own_name = run.job.conditions.protocol.name
        if parameters["name"] == own_name:  # contains only LPIPS, see `altered_evaluations`
            pairs.append((stored, found))
            same = None in (_lpips_of(stored), _lpips_of(found)) or _lpips_of(stored) == _lpips_of(found)
        elif (made := again.evaluations.get(name)) is not None:
            pairs.append((stored, made["metrics"]))
            same = parameters == made["protocol"] and _same_numbers(*pairs[-1])
        else:
            try:
                pairs.append((stored, measure_again(again, protocol_from(parameters, run.directory))))
                same = _same_numbers(*pairs[-1])
            except InputError as error:
                unknown.append(f"{store.EVALUATIONS}/{name} cannot be measured here: {error}")
                continue
        if not same:
            wrong.append(name)
    if any(_lpips_of(stored) is not None and _lpips_of(numbers) is None for stored, numbers in pairs):
        unknown.append("its LPIPS cannot be measured here, as the weights are missing")
    return [f"{store.EVALUATIONS}/{name}" for name in wrong], unknown


def environment_differences(run: Run, again: Run) -> list[str]:
    """Return texts on differences between two runs that can change bytes: processor, versions, code, LPIPS weights."""
    found = []
    before, now = (str(one.timing["hardware"]["processor"]) for one in (run, again))
    if before != now:
        found.append(f"made on {before}, played again on {now}")
    for name, version in run.config["versions"].items():
        other = again.config["versions"].get(name)
        if version != other and name not in _SHOWING:
            shown = [text[:12] if name == "code" else text for text in (version, str(other))]
            found.append(f"{name} was {shown[0]}, is {shown[1]}")
    before_, now_ = (one.config.get(OWN_CODE, {}) for one in (run, again))
    found += [f"{name} has changed since" for name, total in before_.items() if now_.get(name, total) != total]
    weights = [one.metrics["metrics"].get("lpips_weights") for one in (run, again)]
    return found + (["the LPIPS weights differ"] if None not in weights and weights[0] != weights[1] else [])


def _same(run: Run, again: Run, name: str) -> bool:
    """Return whether the file ``name`` is equal in both runs, apart from the differences allowed in JSON files."""
    files = [one.directory / name for one in (run, again)]
    if name == store.PLY and not files[0].exists():  # a user may delete it
        return True
    if not all(file.is_file() for file in files):
        return not any(file.exists() for file in files)
    if files[0].read_bytes() == files[1].read_bytes():
        return True
    if name == store.CONFIG:
        return _is_as_written(files[0], run.config) and _text(_job_alone(run.config)) == _text(_job_alone(again.config))
    if name == store.METRICS:
        stored, found = ({**one.metrics, "metrics": None} for one in (run, again))
        same = _same_numbers(run.metrics["metrics"], again.metrics["metrics"])
        return _is_as_written(files[0], run.metrics) and same and _text(stored) == _text(found)
    return False


def _job_alone(config: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a ``config.json`` without versions, plug-in code, and the scene's path and name.

    The hash of the scene's content is kept.
    """
    kept = {name: value for name, value in config.items() if name not in ("versions", OWN_CODE)}
    scene = {name: value for name, value in config["scene"].items() if name not in ("spec", "source", "name")}
    return {**kept, "scene": scene, "job": {**config["job"], "scene": None}}


def _same_numbers(stored: dict[str, Any], found: dict[str, Any]) -> bool:
    """Return whether all metrics are bit-identical; LPIPS is ignored if ``stored`` or ``found`` has none."""
    if _lpips_of(stored) is None or _lpips_of(found) is None:
        stored, found = without_lpips(stored), without_lpips(found)
    return _text(stored) == _text(found)


def _lpips_of(numbers: dict[str, Any]) -> list[Any] | None:
    """Return the mean LPIPS followed by the LPIPS of every view; None if all are missing."""
    values = [numbers.get("lpips"), *(view.get("lpips") for view in numbers["views"])]
    return None if values == [None] * len(values) else values


def _is_as_written(file: Path, content: Any) -> bool:
    """Return whether a file's bytes equal the text that `json_files.json_text` writes for its content.

    So repeated keys and another layout are detected.
    """
    return file.read_bytes() == json_files.json_text(content).encode("utf-8")


def _text(content: Any) -> str:
    """Return JSON text with sorted keys; unlike values in Python, the text distinguishes 1, 1.0 and true."""
    return json.dumps(content, sort_keys=True)


def _is_scalar(value: Any) -> bool:
    return not isinstance(value, dict | list)


def _is_close(stored: Any, value: Any) -> bool:
    if isinstance(stored, int | float) and isinstance(value, int | float):
        return math.isclose(stored, value, rel_tol=_CLOSE, abs_tol=_CLOSE_TO_0)
    return bool(stored == value)


def _shown(value: Any) -> str:
    return "none" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def _first(texts: Any) -> list[str]:
    found: Sequence[str] = list(texts)
    return [*found[:_MAX_NAMED], *([f"{len(found) - _MAX_NAMED} more numbers"] if len(found) > _MAX_NAMED else [])]
