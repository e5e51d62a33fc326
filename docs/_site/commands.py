"""Make the reference of the command line: a page per command of ``asg``, read from the help that it prints."""

from __future__ import annotations

import inspect
import io
import os
import re
from contextlib import redirect_stdout, suppress
from functools import cache
from unittest.mock import patch

from _site.reference import escaped
from activestructure_gym.evaluation.cli.commands import GROUPS, SHOWN, find_command, parts_of, summary
from activestructure_gym.evaluation.cli.parsing import parse


def pages() -> dict[str, str]:
    """Return the index of the commands and one page per command, by file name."""
    lists = [
        f"## {group}\n\n" + "\n".join(f"- [`asg {name}`]({name}.md): {summary(name)}." for name in commands)
        for group, commands in GROUPS.items()
    ]
    names = "\n".join(f"asg {name} <{name}>" for name in SHOWN)
    index = (
        "# Command line\n\n`asg COMMAND --help` prints the same texts.\n\n"
        + "\n\n".join(lists)
        + f"\n\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )
    return {"cli/index.md": index, **{f"cli/{name}.md": _page(name) for name in SHOWN}}


def options(text: str) -> list[tuple[str, str]]:
    """Return (option, description) of every option in a help text whose lines are not folded, without --help."""
    found = list[tuple[str, str]]()
    for line in re.findall(r"^│ (.*?) *│$", text.partition(" subcommands ")[0], re.MULTILINE):
        name, _, words = line.partition("  ")
        if name:
            found.append((name, words.strip()))
        else:
            found[-1] = (found[-1][0], f"{found[-1][1]} {line.strip()}".strip())
    return [pair for pair in found if not pair[0].startswith("-h,")]


@cache
def help_of(name: str, *words: str) -> str:
    """Return the text that ``asg NAME WORDS --help`` prints, without folded lines."""
    text = io.StringIO()
    with patch.dict(os.environ, COLUMNS="1000"), redirect_stdout(text), suppress(SystemExit):
        parse(find_command(name), name, [*words, "--help"])
    return text.getvalue()


def _page(name: str) -> str:
    parts = parts_of(find_command(name))
    sections = [f"# `asg {name}`", _section(find_command(name), name)]
    for part, kind in parts.items():
        sections += [f"## `asg {name} {part}`", _section(kind, name, part)]
    return "\n\n".join(sections) + "\n"


def _section(kind: type, name: str, *words: str) -> str:
    text = help_of(name, *words)
    usage = text.partition("\n")[0].removeprefix("usage: ").replace("[-h] ", "")
    sections = [_marked(inspect.getdoc(kind) or ""), f"```text\n{usage}\n```"]
    if rows := options(text):
        lines = [f"| {escaped(f'`{option}`')} | {_marked(said)} |" for option, said in rows]
        sections.append("\n".join(["| option | effect |", "|---|---|", *lines]))
    return "\n\n".join(sections)


def _marked(text: str) -> str:
    """Escape a text as Markdown, and mark options such as --out as code."""
    parts = text.split("`")
    parts[::2] = [re.sub(r"(?<![\w-])(--[a-z][\w-]*(?:=[^\s)]+)?)", r"`\1`", part) for part in parts[::2]]
    return escaped("`".join(parts))
