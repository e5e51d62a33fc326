"""Whether a run in the native setup was played with what its policy brings today (`Policy.native_settings`).

A schedule is code of this package: a job names the policy alone, so a run keeps its hash when the schedule changes.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import schema, store
from activestructure_gym.evaluation.archive.jobs import Job

# Fields that schedules change, beside those in `NativeSettings.changes`.
_FIELDS = (
    "mapper.name", "mapper.iterations", "views.stages", "views.max_candidates", "keyframe_every",
    "motion.candidate_clearance",
)  # fmt: skip
_CHECK = schema.table({}, {"configuration": schema.anything}, others=schema.anything)


def changed_native_settings(directory: Path, job: Job) -> list[str]:
    """Fields of a finished run's configuration that its policy's schedule sets otherwise today.

    Empty in the shared setup, for policies that are plug-in code (`plugin_code` covers that), and for runs without a
    record of their configuration.
    """
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.policies.native_settings import native_settings_of

    name = job.spec.name
    if job.conditions.setup == "shared" or name not in POLICIES or POLICIES.imports(name):
        return []
    schedule = native_settings_of(POLICIES.get(name), job.conditions.setup)
    config = configure(job.conditions.preset, schedule.overrides() | dict(job.conditions.overrides))
    now = json.loads(json.dumps(store.plain(dataclasses.asdict(config))))
    try:
        then = store.read_json(directory / store.CONFIG, _CHECK).get("configuration", {})
    except InputError:
        return []
    fields = dict.fromkeys((*_FIELDS, *schedule.changes))
    return [field for field in fields if _at(then, field, _at(now, field)) != _at(now, field)]


def _at(content: Any, field: str, default: Any = None) -> Any:
    """The value at a dotted name."""
    for part in field.split("."):
        if not isinstance(content, dict) or part not in content:
            return default
        content = content[part]
    return content
