"""Compare the settings of a run in the native setup with the policy's current `Policy.native_settings`.

Native settings are code of this package. A job names only the policy, so its hash does not change with them.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import json_files, run_files, schema, store
from activestructure_gym.evaluation.archive.jobs import Job, code_of

_CHECK = schema.table({}, {"configuration": schema.anything}, others=schema.anything)


def changed_native_settings(directory: Path, job: Job) -> list[str]:
    """Return the configuration fields whose recorded values differ from the policy's current native settings.

    The list is empty in the shared setup, for plug-in policies (`plugin_code` covers them), and for runs whose
    configuration cannot be read.
    """
    from activestructure_gym.policies import POLICIES, make_policy
    from activestructure_gym.policies.native_settings import native_settings_of

    plug_in = any(kind == POLICIES.kind for kind, _ in code_of(job))  # importing it would run another person's code
    if job.conditions.setup == "shared" or job.policy.name not in POLICIES or plug_in:
        return []
    settings = native_settings_of(make_policy(job.policy), job.conditions.setup)
    config = configure(job.conditions.preset, settings.overrides() | dict(job.conditions.overrides))
    now = json_files.as_read(dataclasses.asdict(config))
    try:
        then = json_files.read_json(directory / store.CONFIG, _CHECK).get("configuration", {})
    except InputError:
        return []
    fields = dict.fromkeys((*run_files.NATIVE_FIELDS, *settings.changes))
    return [field for field in fields if _at(then, field, _at(now, field)) != _at(now, field)]


def _at(content: Any, field: str, default: Any = None) -> Any:
    """Return the value at a dotted name of nested dictionaries, or the default."""
    for part in field.split("."):
        if not isinstance(content, dict) or part not in content:
            return default
        content = content[part]
    return content
