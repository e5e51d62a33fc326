"""Make the page of the configuration: every field with its default and meaning, and the values of the presets."""

from __future__ import annotations

import json
from typing import Any

from _site.reference import escaped
from activestructure_gym.config import PRESETS, ReconstructionConfig, configure
from activestructure_gym.evaluation.cli.config import leaves, meanings


def pages() -> dict[str, str]:
    """Return the page by file name."""
    config = ReconstructionConfig()
    values, texts = dict(leaves(config)), dict(meanings(config))
    presets = {name: dict(leaves(configure(name))) for name in PRESETS}
    changed = [name for name in values if any(preset[name] != values[name] for preset in presets.values())]
    lines = [
        "# Configuration\n",
        "`--set FIELD=VALUE` changes a field, and so does `config={FIELD: VALUE}` in Python.\n",
        "## Presets\n",
        *_table(
            ["field", *presets], [[f"`{name}`", *(_shown(each[name]) for each in presets.values())] for name in changed]
        ),
    ]
    groups: dict[str, list[list[str]]] = {}
    for name, value in values.items():
        row = [f"`{name}`", _shown(value), escaped(texts[name])]
        groups.setdefault(name.partition(".")[0] if "." in name else "episode", []).append(row)
    for group, rows in groups.items():
        lines += [f"## {group}\n", *_table(["field", "default", "meaning"], rows)]
    return {"configuration/index.md": "\n".join(lines)}


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows)] + [""]


def _shown(value: Any) -> str:
    return escaped(f"`{value if isinstance(value, str) else json.dumps(value)}`") if value != "" else ""
