"""Define a job, one cell of a comparison's grid: everything that determines an episode and its metrics."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import operator
import os
import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from activestructure_gym._version import __version__
from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.json_files import plain
from activestructure_gym.evaluation.protocols import PROTOCOLS
from activestructure_gym.evaluation.protocols.metrics import METRICS
from activestructure_gym.specs import Spec

if TYPE_CHECKING:
    from activestructure_gym.registry import Registry

REFERENCE = "reference:"  # prefix of the name of a reference, which uses the ground truth, in ``Job.policy``
TRAJECTORY = "trajectory:"  # prefix of the path of a given trajectory in ``Job.policy``
CELL = ("scene", "policy", "seed", "scene_hash", "swept")  # fields that differ between the jobs of a comparison
_HASH_DIGITS = 12
MAX_SEED = 2**63 - 1
_LABEL_DIGITS = 8  # digits of a content hash in a label
# Generic names of trajectory files and folders.
_USUAL_STEMS = ("traj", "traj_w_c", "trajectory", "poses", "pose", "transforms", "images", "data")
_RUN = re.compile(r"--seed\d+--[0-9a-f]{12}$")  # end of a run directory's name
_MAX_NAME_CHARACTERS = 80  # maximum length of the scene, and of the policy, in a directory's name


@dataclass(frozen=True)
class Job:
    """Describe one policy on one scene with one seed. Equal jobs give equal results on equal machines.

    Parameters
    ----------
    scene
        Scene spec as `load_scene` takes it. A text is parsed.
    policy
        Policy spec, as ``"naruto?travel=shared"`` or ``"module:Class"``; or a reference or a trajectory. A text is
        parsed.
    seed
        Seed of the start pose, the sensor noise, the path planner and the policy.
    scene_hash
        Content hash of the loaded scene. A scene file with other content makes another job.
    conditions
        Conditions of this job. All jobs of a comparison share them, except the values of swept fields.
    swept
        Names of the swept fields: configuration fields that differ between the jobs of a comparison. The job's values
        are in the overrides of ``conditions``.
    """

    scene: Spec
    policy: Spec
    seed: int
    scene_hash: str = ""
    conditions: Conditions = field(default_factory=Conditions)
    swept: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for kind, text in (("scene", self.scene), ("policy", self.policy)):
            object.__setattr__(self, kind, Spec(text))
            check_in_one_line(kind, text)
        check_in_one_line("swept value", self.swept_text)
        try:
            seed = -1 if isinstance(self.seed, bool) else operator.index(self.seed)  # also NumPy's whole numbers
        except TypeError:
            seed = -1
        if not 0 <= seed <= MAX_SEED:
            raise InputError(f"a seed is a whole number from 0 to {MAX_SEED}, got {short_repr(self.seed)}")
        object.__setattr__(self, "seed", seed)

    @cached_property
    def hash(self) -> str:
        """Return a hash of 12 hex digits over all fields except the scene's spec, and the version of this package."""
        content = {key: value for key, value in self.as_dict().items() if key != "scene"}
        text = json.dumps([__version__, content], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]

    @cached_property
    def name(self) -> str:
        """Return the name of the job's run directory."""
        # The path of a checkpoint can be longer than a file name; the hash covers all of it.
        policy = slug(self.policy + self.swept_text)[-_MAX_NAME_CHARACTERS:]
        scene = slug(scene_label(self.scene))[-_MAX_NAME_CHARACTERS:]
        return f"{scene}--{policy}--seed{self.seed}--{self.hash}"

    @property
    def title(self) -> str:
        """Return scene, policy, swept values and seed as a short text for messages and tables."""
        return self._titled(scene_label(self.scene))

    def _titled(self, scene: str) -> str:
        return f"{scene} · {self.label} · seed {self.seed}"

    @property
    def label(self) -> str:
        """Return a short name of the policy and the swept values, as in ``naruto [mapper.seed_spacing=0.06]``."""
        return policy_label(self.policy) + self.swept_text

    @property
    def swept_values(self) -> dict[str, Any]:
        """Return the job's values of the swept fields, by field."""
        given = self.conditions.overrides
        return {name: plain(given[name]) for name in self.swept if name in given}

    @property
    def swept_text(self) -> str:
        """Return the swept values as a suffix for the policy's name; empty without any."""
        found = ", ".join(f"{name}={value_text(value)}" for name, value in self.swept_values.items())
        return f" [{found}]" if found else ""

    @property
    def shared_conditions(self) -> Conditions:
        """Return the conditions without the swept values: those that all jobs of a comparison share."""
        kept = {name: value for name, value in self.conditions.overrides.items() if name not in self.swept}
        return dataclasses.replace(self.conditions, overrides=kept) if self.swept else self.conditions

    def as_dict(self) -> dict[str, Any]:
        """Return the job as plain values for JSON; ``swept`` has the values by field, and is omitted if empty."""
        cell = {name: getattr(self, name) for name in CELL} | {"swept": self.swept_values}
        if not self.swept:
            del cell["swept"]
        return cell | self.shared_conditions.as_dict()

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Job:
        """Create the job from ``content``, the result of `as_dict`; raise `InputError` for unknown fields."""
        known = {*CELL, *(one.name for one in dataclasses.fields(Conditions))}
        if more := content.keys() - known:
            raise InputError(f"a job of this version has no {', '.join(sorted(more))}; make the run again")
        cell = {name: content[name] for name in CELL if name in content}
        swept = cell.pop("swept", {})
        shared = {name: value for name, value in content.items() if name not in CELL}
        if swept:
            shared["overrides"] = {**shared["overrides"], **swept}
        return cls(**cell, conditions=Conditions.from_dict(shared), swept=tuple(swept))


def value_text(value: Any) -> str:
    """Return a value of a configuration field as ``--set`` takes it: a text as it is, and other values as JSON."""
    return value if isinstance(value, str) else json.dumps(value)


def check_in_one_line(kind: str, name: str) -> None:
    """Raise `InputError` for a name with line breaks or control characters, which tables cannot show."""
    if any(unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp") for letter in name):
        raise InputError(
            f"the {kind} {short_repr(name)} has a line break or a control character in its name: rename it"
        )


def refuse_code(jobs: Iterable[Job], file: object) -> None:
    """Raise `InputError` if jobs that were read from ``file`` name plug-in code that is not trusted.

    Registered names and files are allowed; see `registry.refuse_code`.
    """
    from activestructure_gym import registry

    for job in jobs:
        for kind, name in code_of(job):
            registry.refuse_code(kind, name, file)


def code_of(job: Job) -> Iterator[tuple[str, str]]:
    """Yield the kind, such as "policy", and the name, ``"module:Name"``, of all plug-in code that a job names."""
    from activestructure_gym.scenes.library import imports_code
    from activestructure_gym.worlds.registry import PREFIX, WORLDS, names_world

    if names_world(job.scene):
        if WORLDS.imports(Spec(job.scene.removeprefix(PREFIX)).name):
            yield "world", job.scene
    elif imports_code(job.scene):
        yield "scene", job.scene
    for registry, name in named_in(job):
        if registry.imports(name.name):
            yield registry.kind, name


def named_in(job: Job) -> Iterator[tuple[Registry[Any], Spec]]:
    """Yield the parts that a job names, each with its registry: policy, protocols, metrics, parts in the overrides.

    `random` names a planner in its option ``views_of``.
    """
    from activestructure_gym.policies import POLICIES

    if job.policy.kind not in ("reference", "trajectory"):
        yield POLICIES, job.policy
        if job.policy.name == "random" and (planner := job.policy.options("policy 'random'").get("views_of")):
            yield POLICIES, Spec(planner)
    yield from ((PROTOCOLS, Spec(name)) for name in job.conditions.also)
    yield from ((METRICS, Spec(name)) for name in job.conditions.metrics)
    yield from named_in_overrides(job.conditions.overrides)


def named_in_overrides(overrides: Mapping[str, Any]) -> Iterator[tuple[Registry[Any], Spec]]:
    """Yield features, candidate sources, mapper and backends in overrides of a configuration, nested or with dots."""
    from activestructure_gym.features import FEATURES
    from activestructure_gym.mapping import MAPPERS
    from activestructure_gym.sensors import RENDERERS
    from activestructure_gym.sources import SOURCES, sources_in
    from activestructure_gym.splatting.backends import BACKENDS

    given = overrides.get("features", ())
    features = given if isinstance(given, list | tuple) else [given]
    found: list[tuple[Registry[Any], Any]] = [(FEATURES, name) for name in features]
    found += [(SOURCES, name) for name in sources_in(overrides)]
    for registry, room, key in (
        (MAPPERS, "mapper", "name"), (BACKENDS, "mapper", "backend"), (RENDERERS, "sensor", "backend")
    ):  # fmt: skip
        nested = overrides.get(room)
        found.append((registry, overrides.get(f"{room}.{key}")))
        found.append((registry, nested.get(key) if isinstance(nested, Mapping) else None))
    yield from ((registry, Spec(name)) for registry, name in found if isinstance(name, str))


def scene_label(spec: str, parts: int = 1) -> str:
    """Return a short name for a scene spec: the file's stem, or the registered name with its options.

    With ``parts`` > 1, up to ``parts`` - 1 parent folders are included, to distinguish files of equal names.
    """
    kind, path, options = split_spec(spec)
    place = PurePath(path)
    stem = place.with_suffix("") if place.name else place  # "." and "/" have no name
    names = stem.parts[bool(place.anchor) :] if "/" in path or "." in path else (path,)
    label = "/".join(names[-parts:]) or path or kind
    short = "&".join(f"{key}={PurePath(value).name}" for key, value in _pairs(options))
    return f"{label}?{short}" if short else label


def scene_labels(hashes: Mapping[str, str]) -> dict[str, str]:  # by spec: the content's hash, empty if unknown
    """Return unique short names by spec, which never contain a complete absolute path.

    If the folder names do not distinguish two files, the first digits of their content hash are added:
    ``house@01234567``. If these are equal or unknown too, a number is added.
    """
    deepest = max((len(PurePath(split_spec(spec)[1]).parts) for spec in hashes), default=1)
    for parts in range(1, max(4, deepest - 1)):
        labels = {spec: scene_label(spec, parts) for spec in hashes}
        if len(set(labels.values())) == len(labels):
            return labels
    by_content = {
        spec: f"{scene_label(spec)}@{content[:_LABEL_DIGITS]}".removesuffix("@") for spec, content in hashes.items()
    }
    taken: dict[str, list[str]] = {}
    for spec, label in by_content.items():
        taken.setdefault(label, []).append(spec)
    return {
        spec: label if len(taken[label]) == 1 else f"{label} ({taken[label].index(spec) + 1})"
        for spec, label in by_content.items()
    }


def one_spec_each(jobs: Sequence[Job]) -> list[Job]:
    """Return the jobs with one spec per scene, so that all jobs use the current path of a scene file that has moved.

    Scenes with the same content and file name are the same scene; the spec of its last job is used. Names and hashes of
    the jobs do not change.
    """
    last = {_scene_of(job): job.scene for job in jobs}
    return [dataclasses.replace(job, scene=last[_scene_of(job)]) for job in jobs]


def _scene_of(job: Job) -> tuple[str, str]:
    return scene_label(job.scene) if job.scene_hash else job.scene, job.scene_hash


def titles_of(jobs: Sequence[Job]) -> dict[str, str]:
    """Return the titles of jobs by `Job.name`; scenes with equal file names get different ones."""
    jobs = one_spec_each(jobs)
    labels = scene_labels({job.scene: job.scene_hash for job in jobs})
    return {job.name: job._titled(labels[job.scene]) for job in jobs}


def ranked_among(policies: Collection[Spec]) -> set[Spec]:
    """Return the policies that tables rank: the planners, or the given trajectories if there are no planners.

    References are never ranked, because they use the ground truth.
    """
    planners = {policy for policy in policies if policy.kind not in ("reference", "trajectory")}
    return planners or {policy for policy in policies if policy.kind != "reference"}


def policy_label(spec: Spec) -> str:
    """Return a short name for a policy, without the folders of a checkpoint or a trajectory.

    - A checkpoint has the name of its file and the digits of its content: ``learned:bc@01234567``. A file named
      ``best`` gets the name of its folder, a training run.
    - A trajectory has the name of its file and the digits of its content: ``trajectory:room0@01234567``. A file with a
      generic name gets that of its folder; the trajectory of a run gets the run's policy and seed.
    """
    if spec.kind == "reference":
        return f"{spec.removeprefix(REFERENCE)} (reference, sees the ground truth)"
    path, at, digits = spec.place.rpartition("@")
    if spec.kind == "trajectory" and at:
        file = PurePath(path)
        name = file.parent.name if file.stem in _USUAL_STEMS and file.parent.name else file.stem
        name = "--".join(name.split("--")[1:3]) if _RUN.search(name) else name
        query = re.sub(r"=[^&]*/([^/&]*?)(\.\w*)?(?=@)", r"=\1", spec.query)  # files of options without their folders
        return Spec.joined(f"{TRAJECTORY}{name}@{digits}", query)
    if spec.kind != "checkpoint" or not at:
        return spec
    file = PurePath(path)
    return f"learned:{file.parent.name if file.stem == 'best' and file.parent.name else file.stem}@{digits}"


def absolute_spec(spec: str) -> str:
    """Return the scene's spec with absolute paths, which are valid in any working directory."""
    from activestructure_gym.scenes.library import is_scene_name
    from activestructure_gym.worlds import names_world

    if names_world(spec):
        name, mark, options = spec.partition("?")
        return name + mark + _absolute_options(options)
    if is_scene_name(spec):
        return spec
    kind, path, options = split_spec(spec)
    if not path or not Path(os.path.expanduser(path)).exists():
        return spec
    places = _absolute_options(options)
    return (f"{kind}:" if kind else "") + _absolute(path) + (f"?{places}" if places else "")


def _absolute_options(options: str) -> str:
    return "&".join(f"{key}={_absolute(value) if '/' in value else value}" for key, value in _pairs(options))


def _absolute(path: str) -> str:
    place = Path(os.path.expanduser(path))
    return str(place.resolve()) if place.exists() else path


def _pairs(options: str) -> list[tuple[str, str]]:
    return [(key, value) for key, _, value in (option.partition("=") for option in options.split("&") if option)]


def split_spec(spec: str) -> tuple[str, str, str]:
    """Split a spec ``kind:path?options`` into kind, path and options; missing parts are empty."""
    if Path(os.path.expanduser(spec)).exists():
        return "", spec, ""
    parsed = Spec(spec)
    kind, colon, rest = parsed.name.partition(":")
    return (
        (kind, rest, parsed.query) if colon and len(kind) > 1 else ("", parsed.name, parsed.query)
    )  # a kind of one letter is a drive of Windows


def slug(text: str) -> str:
    """Return ``text`` with all characters replaced that a file name cannot contain on every system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip("-.") or "unnamed"
