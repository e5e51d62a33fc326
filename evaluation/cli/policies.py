"""Define ``asg list policies``, which lists all policies or describes the named ones."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from activestructure_gym.evaluation.cli.fields import Switch, option
from activestructure_gym.evaluation.cli.listing import print_json, print_listed, print_text
from activestructure_gym.evaluation.cli.options import split_list
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.specs import Spec
from activestructure_gym.streams import escape, say

_QUALIFIED = re.compile(r"^(by a digest of|by the text of|inspired by) ")


@dataclass(frozen=True)
class Policies:
    """List the policies, or describe some.

    The list has source and decision rule of each policy; --wide adds the features that it needs.
    """

    names: Annotated[tuple[str, ...], tyro.conf.Positional, option("[NAME ...]", "")] = ()
    """Describe these, with their options."""
    wide: Switch = False
    """Print all columns, whatever the width of the terminal."""
    json: Switch = False
    """Print JSON."""

    def run(self) -> int:
        """Print a table of all registered policies, or the named ones with their options and whole descriptions."""
        from activestructure_gym.policies import POLICIES, canonical_policy

        names = split_list(self.names)
        if not names:
            rows = [_policy_facts(name) for name in POLICIES]
            if self.json:
                return print_json(rows)
            heads = ["name", "source", "criterion"]
            if self.wide:
                heads.insert(2, "features it needs")
            print_listed("Policies", heads, [_entries(row, wide=self.wide) for row in rows], _HINT, wide=self.wide)
            return 0
        found = [_policy_facts(canonical_policy(name) if "?" in name else name) for name in names]
        if self.json:
            return print_json(found if len(found) > 1 else found[0])
        for number, facts in enumerate(found):
            if number:
                say()
            _describe(facts)
        return 0


_HINT = "One with its options: asg list policies NAME; your own: asg list policies MODULE:CLASS."


def _entries(facts: dict[str, Any], *, wide: bool) -> list[str]:
    """Return a policy's table row: name, shortened source, decision rule; with ``wide``, whole source and features."""
    if wide:
        return [facts["name"], facts["source"], ", ".join(facts["features"]), facts["criterion"]]
    source = _QUALIFIED.sub("after ", facts["source"]).partition(",")[0]
    return [facts["name"], source, facts["criterion"]]


def _describe(facts: dict[str, Any]) -> None:
    """Print the description and the options of one policy, given its facts from `_policy_facts`."""
    console = make_console()
    console.print(f"[bold]{escape(facts['name'])}[/]  {escape(facts['source'])}")
    print_text(console, facts["about"])
    console.print(f"\nFeatures it needs: {escape(', '.join(facts['features']) or 'none')}")
    console.print(f"Its own travel term: {escape(facts['travel_term'])}.")
    console.print(escape(f"Native settings: {facts['native']}."))
    if not facts["options"]:
        console.print("It takes no options.")
        return
    table = plain_table("Options", "name", "default")
    for name, default in facts["options"].items():
        table.add_row(escape(name), escape("must be given" if name in facts["required"] else str(default)))
    print_whole(console, table)
    example = f"{facts['name'].partition('?')[0]}?{next(iter(facts['options']))}=..."
    console.print(escape(f"They are written as in '{example}', in quotes, or a shell reads the ? and the &"))


def features_asked(name: str) -> tuple[str, ...]:
    """Return the feature columns that the policy ``name`` needs; the name may include options, as in active_gs?a=b."""
    from activestructure_gym.policies.base import features_of

    return features_of(_made(name))


def _made(name: str) -> Any:
    """Return the policy ``name`` with its options, or its class if options without a default are not given."""
    from activestructure_gym.policies import POLICIES, make_policy

    kind: Any = POLICIES.get(Spec(name).name)
    return kind if _required(kind) and "?" not in name else make_policy(name)


def _required(kind: type) -> list[str]:
    return [p.name for p in inspect.signature(kind).parameters.values() if p.default is p.empty]


def _policy_facts(name: str) -> dict[str, Any]:
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.policies.native_settings import native_settings_of

    kind: Any = POLICIES.get(Spec(name).name)
    parameters = inspect.signature(kind).parameters.values()
    about = _docstring(kind)
    return {
        "name": name,
        "criterion": kind.criterion or about.partition("\n")[0],
        "features": list(features_asked(name)),
        "travel_term": kind.travel_term,
        "source": kind.source,
        "native": native_settings_of(_made(name), "native").describe(),
        "options": {p.name: None if p.default is p.empty else p.default for p in parameters},
        "required": _required(kind),
        "about": about,
    }


def _docstring(kind: type) -> str:
    """Return the docstring of a policy class; without one, that of the nearest parent that is a concrete policy."""
    from activestructure_gym.policies import Policy

    policies = (parent for parent in kind.__mro__ if issubclass(parent, Policy) and not inspect.isabstract(parent))
    return inspect.cleandoc(next((text for parent in policies if (text := vars(parent).get("__doc__"))), ""))
