"""Define ``asg list config``, which prints the configuration of an episode."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import textwrap
import tokenize
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import StringIO
from typing import Annotated, Any

import tyro

from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.cli.fields import Changes, Switch, option
from activestructure_gym.evaluation.cli.listing import print_json, print_listed
from activestructure_gym.evaluation.cli.options import parse_overrides, split_list
from activestructure_gym.streams import say


@dataclass(frozen=True)
class Config:
    """List the fields of an episode's configuration.

    Print the value, the default and the meaning of each.
    """

    words: Annotated[tuple[str, ...], tyro.conf.Positional, option("[rl|fast|default|full|paper] [FIELD ...]", "")] = ()
    """Print this preset (default: default), or of it only these fields or groups of fields (sensor, mapper.window)."""
    set: Changes = ()
    """Change fields, as in compare and train; the changes are printed at the end."""
    wide: Switch = False
    """Print all columns, whatever the width of the terminal."""
    json: Switch = False
    """Print JSON, which `gym.make(..., config=...)` takes."""

    def run(self) -> int:
        """Print the fields, and the changes by the preset and by ``--set``."""
        from activestructure_gym.config import ReconstructionConfig, configure, known_preset

        words = split_list(self.words)
        fields = words[1:] if words and not _is_of(words[0], ReconstructionConfig()) else words
        preset_name = known_preset("default" if fields == words else words[0])
        preset = configure(preset_name)
        chosen = configure(preset_name, parse_overrides(self.set))
        if self.json:
            return print_json(dataclasses.asdict(chosen))
        defaults = dict(leaves(ReconstructionConfig()))
        before, after, texts = dict(leaves(preset)), dict(leaves(chosen)), dict(meanings(chosen))
        groups = list(dict.fromkeys(name.partition(".")[0] for name in after))
        for field in fields:
            if not _is_of(field, chosen):
                within = [name for name in after if name.startswith(field.partition(".")[0] + ".")]
                raise unknown_name("field or group of fields", field, within or groups)
        rows = []
        for name, value in after.items():
            if fields and not any(name == field or name.startswith(f"{field}.") for field in fields):
                continue
            default = "" if name not in defaults or value == defaults[name] else _shown(defaults[name])
            rows.append([name, _shown(value), *([default] if self.wide else []), texts[name]])
        heads = ["field", "value", *(["default"] if self.wide else []), "meaning"]
        print_listed(f"Preset {preset_name}", heads, rows, _HINTS[self.wide], wide=self.wide, most=_MAX_COLUMNS)
        changes = [name for name, value in after.items() if name in before and value != before[name]]
        for name in changes:
            say(f"--set {name}: {_shown(before[name])} -> {_shown(after[name])}")
        return 0


_MAX_COLUMNS = (36, 10)  # widths of the columns "field" and "value" in characters; longer entries shorten the meaning
_HINTS = {
    False: "Whole texts, and what the preset changes: --wide. Change a field: --set FIELD=VALUE.",
    True: "Where nothing is under default, the value is the default. Change a field: --set FIELD=VALUE.\n"
    "Measured: docs/notebook/map.md and docs/notebook/lab_notes.md",
}


def _is_of(word: str, config: Any) -> bool:
    """Return whether ``word`` names a field of ``config``, such as "mapper.window", or a group, such as "mapper"."""
    return any(name == word or name.startswith(f"{word}.") for name, _ in leaves(config))


def leaves(config: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, value) of every field of a nested dataclass; ``before`` is the prefix of the names."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from leaves(value, f"{before}{field.name}.")
        else:
            yield before + field.name, value


def meanings(config: Any, before: str = "") -> Iterator[tuple[str, str]]:
    """Yield (dotted name, description) of every field of a nested dataclass; ``before`` is the prefix of the names.

    If a subclass redefines a field without a description, the parent's description is used.
    """
    lineage = reversed(type(config).__mro__[:-1])
    notes = {name: note for kind in lineage for name, note in field_notes(kind).items() if note}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from meanings(value, f"{before}{field.name}.")
        else:
            yield before + field.name, notes.get(field.name, "")


def field_notes(kind: type) -> Mapping[str, str]:
    """Return the description of each field of a dataclass by name, read from the source code.

    The description is the string below the field, else the comment on its line, else the comment above it.
    """
    source = textwrap.dedent(inspect.getsource(kind))
    comments = {
        token.start[0]: (token.string.lstrip("# ").rstrip(), token.line.strip().startswith("#"))
        for token in tokenize.generate_tokens(StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    body = next(node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)).body
    notes = {}
    for node, after in zip(body, [*body[1:], None]):
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            notes[node.target.id] = " ".join(after.value.value.split())
        elif (node.end_lineno or node.lineno) in comments:
            notes[node.target.id] = comments[node.end_lineno or node.lineno][0]
        else:
            above, line = list[str](), node.lineno - 1
            while line in comments and comments[line][1]:
                above.insert(0, comments[line][0])
                line -= 1
            notes[node.target.id] = " ".join(above)
    return notes


def _shown(value: Any) -> str:
    return json.dumps(value) if not isinstance(value, str) else value
