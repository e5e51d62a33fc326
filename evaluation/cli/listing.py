"""``asg policies``, ``asg features``, ``asg config``: what there is by name, and what it is set to."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import re
import textwrap
import tokenize
from collections.abc import Iterable, Iterator, Mapping
from io import StringIO
from typing import Any

from rich.markup import escape

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import Config, Features, Policies
from activestructure_gym.evaluation.cli.options import parse_overrides
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole


def policies(options: Policies) -> int:
    """All registered policies in a table, or one with its options and its whole description."""
    from activestructure_gym.policies import POLICIES, canonical_policy

    if options.name is None:
        rows = [_policy_facts(name) for name in POLICIES]
        if options.json:
            return _print_json(rows)
        table = plain_table("Policies", "name", "decides by", "source", "gains it needs")
        for row in rows:
            gains = ", ".join(_grouped(row["gains"]))
            table.add_row(*map(escape, (row["name"], row["decides_by"], row["source"], gains)))
        _print(table, "One of them with its options: asg policies NAME")
        return 0
    facts = _policy_facts(canonical_policy(options.name) if "?" in options.name else options.name)
    if options.json:
        return _print_json(facts)
    console = make_console()
    console.print(f"[bold]{escape(facts['name'])}[/]  {escape(facts['source'])}")
    console.print(escape(facts["about"]), soft_wrap=True)
    console.print(f"\nGains it needs: {escape(', '.join(_grouped(facts['gains'])) or 'none')}", soft_wrap=True)
    if not facts["options"]:
        console.print("It takes no options.")
        return 0
    table = plain_table("Options", "name", "default")
    for name, default in facts["options"].items():
        table.add_row(escape(name), escape(str(default)))
    print_whole(console, table)
    console.print(escape(f"They are written as in {options.name.partition('?')[0]}?{next(iter(facts['options']))}=..."))
    return 0


def features(options: Features) -> int:
    """All gains: what each is, and in which unit."""
    from activestructure_gym.features import GAINS
    from activestructure_gym.features.units import UNITS

    rows = [{"name": name, "about": _first_line(GAINS.get(name)), "unit": UNITS.get(name, "")} for name in GAINS]
    if options.json:
        return _print_json(rows)
    table = plain_table("Gains of a candidate view", "name", "unit", "what it is")
    for name in _grouped([row["name"] for row in rows]):
        row = next(row for row in rows if row["name"] == name.partition(" .. ")[0])
        table.add_row(*map(escape, (name, row["unit"], row["about"])))
    _print(table, "A policy names those it needs; asg train --gains and gains=... of an environment take any.")
    return 0


def config(options: Config) -> int:
    """The configuration of an episode, field by field, and what the preset and ``--set`` change of the defaults."""
    from activestructure_gym.config import ReconstructionConfig, configure

    preset = configure(options.preset)
    chosen = configure(options.preset, parse_overrides(options.set))
    if options.json:
        return _print_json(dataclasses.asdict(chosen))
    defaults = dict(leaves(ReconstructionConfig()))
    before, after, meanings = dict(leaves(preset)), dict(leaves(chosen)), dict(_meanings(chosen))
    table = plain_table(f"Preset {options.preset}", "field", "value", "default", "meaning")
    for name, value in after.items():
        style = "bold" if value != before[name] else None
        default = "" if value == defaults[name] else _shown(defaults[name])
        table.add_row(*map(escape, (name, _shown(value), default, meanings[name])), style=style)
    _print(table, "Where nothing stands under default, the value is it. Changes: --set FIELD=VALUE")
    changes = [name for name, value in after.items() if value != before[name]]
    for name in changes:
        print(f"--set {name}: {_shown(before[name])} -> {_shown(after[name])}")
    return 0


def _policy_facts(name: str) -> dict[str, Any]:
    from activestructure_gym.policies import POLICIES, make_policy
    from activestructure_gym.policies.base import gains_of

    kind: Any = POLICIES.get(name.partition("?")[0])
    try:  # some ask for a gain more or less by their options
        gains = gains_of(make_policy(name))
    except InputError:  # it has an option without a default
        gains = gains_of(kind)
    parameters = inspect.signature(kind).parameters.values()
    return {
        "name": name,
        "decides_by": kind.decides_by or _first_line(kind),
        "gains": list(gains),
        "source": kind.source,
        "options": {p.name: None if p.default is p.empty else p.default for p in parameters},
        "about": inspect.getdoc(kind) or "",
    }


def _first_line(thing: Any) -> str:
    """Of a function or class, also of one with some of its arguments given."""
    return (inspect.getdoc(getattr(thing, "func", thing)) or "").partition("\n")[0]


def _grouped(names: Iterable[str]) -> list[str]:
    """Names, those that differ in nothing but a number and an axis as one: ``look_0_x .. look_9_z``."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"(_\d+)?_[xyz]$", " by axis", name), []).append(name)
    return [members[0] if len(members) == 1 else f"{members[0]} .. {members[-1]}" for members in groups.values()]


def leaves(config: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """The fields of a nested dataclass by their dotted names."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from leaves(value, f"{before}{field.name}.")
        else:
            yield before + field.name, value


def _meanings(config: Any, before: str = "") -> Iterator[tuple[str, str]]:
    notes = field_notes(type(config))
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from _meanings(value, f"{before}{field.name}.")
        else:
            yield before + field.name, notes.get(field.name, "")


def field_notes(kind: type) -> Mapping[str, str]:
    """What a dataclass's source says of its fields: a text below, a comment behind, or else comments above."""
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


def _print(table: Any, hint: str) -> None:
    console = make_console()
    print_whole(console, table)
    console.print(hint)


def _print_json(content: Any) -> int:
    print(json.dumps(content, indent=1, default=str, ensure_ascii=False))
    return 0
