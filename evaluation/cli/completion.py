"""``asg completion``: what a shell needs to complete commands, options, and the names that options take.

The names stand in the script, so that completing starts no Python; a plug-in that is installed later needs a new one.
"""

from __future__ import annotations

import dataclasses
import shlex
import typing
from collections.abc import Sequence
from typing import Any, Literal

import tyro

from activestructure_gym.evaluation.cli.commands import COMMANDS, Completion


def completion(options: Completion) -> int:
    """Print the script."""
    print({"bash": _bash, "zsh": _zsh, "fish": _fish}[options.shell]())
    return 0


@dataclasses.dataclass(frozen=True)
class _Entry:
    """An option, or what may stand in the place of one."""

    name: str  # "" for what stands alone
    words: Sequence[str] | None  # that it takes; () takes none, None is a file


def _entries(kind: type) -> list[_Entry]:
    names = _names()
    entries = [_Entry("--help", ())]
    for name, hint in typing.get_type_hints(kind, include_extras=True).items():
        base, *about = typing.get_args(hint) if typing.get_origin(hint) is typing.Annotated else (hint,)
        choices = [word for part in (base, *typing.get_args(base)) for word in _literals(part)]
        alone = any(part is tyro.conf.Positional for part in about)
        words: Sequence[str] | None = choices or names.get(f"{kind.__name__}.{name}") or names.get(name)
        if base is bool or (words is None and _is_number(base)):
            words = ()
        entries.append(_Entry("" if alone else f"--{name.replace('_', '-')}", words))
        if base is bool and getattr(kind, name, False):
            entries.append(_Entry(f"--no-{name.replace('_', '-')}", ()))
    return entries


def _literals(hint: Any) -> list[str]:
    return list(typing.get_args(hint)) if typing.get_origin(hint) is Literal else []


def _is_number(hint: Any) -> bool:
    return any(part in (int, float) for part in (hint, *typing.get_args(hint)))


def _names() -> dict[str, Sequence[str]]:
    """Per option the names it takes."""
    from activestructure_gym.config import PRESETS, ReconstructionConfig
    from activestructure_gym.evaluation.cli.listing import leaves
    from activestructure_gym.features import GAINS
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.scenes import SCENES

    scenes, gains = list(SCENES), list(GAINS)
    return {
        "Policies.name": list(POLICIES),
        "Scenes.spec": scenes,
        "set": [f"{name}=" for name, _ in leaves(ReconstructionConfig())],
        "policies": [*POLICIES, "ladder", "all"],
        "baseline": list(POLICIES),
        "scenes": scenes,
        "scene": scenes,
        "preset": list(PRESETS),
        "gains": gains,
        "teacher": ["oracle", *gains],
        "engine": ["local", "inline", "ray"],
        "protocols": ["standard", "activegamer"],
        "protocol": ["standard", "activegamer"],
    }


def _bash() -> str:
    cases, alone = [], []
    for command, kind in COMMANDS.items():
        entries = _entries(kind)
        for entry in entries:
            if entry.name and entry.words:
                cases.append(f"    {command}:{entry.name}) words={shlex.quote(' '.join(entry.words))} ;;")
            elif entry.name and entry.words is None:
                cases.append(f"    {command}:{entry.name}) files=1 ;;")
        words = [entry.name for entry in entries if entry.name]
        words += [word for entry in entries if not entry.name for word in entry.words or ()]
        alone.append(f"    {command}) words={shlex.quote(' '.join(words))} ;;")
    return _BASH.format(commands=" ".join((*COMMANDS, "help")), cases="\n".join(cases), alone="\n".join(alone))


def _zsh() -> str:
    return "autoload -U +X bashcompinit && bashcompinit\n" + _bash()


def _fish() -> str:
    lines = ["complete -c asg -n __fish_use_subcommand -f"]
    for command, kind in COMMANDS.items():
        text = (kind.__doc__ or "").partition("\n")[0].partition(";")[0]
        lines.append(f"complete -c asg -n __fish_use_subcommand -a {command} -d {shlex.quote(text)}")
        here = f"-n '__fish_seen_subcommand_from {command}'"
        for entry in _entries(kind):
            if not entry.name:
                lines += [f"complete -c asg {here} -a {shlex.quote(' '.join(entry.words))}"] if entry.words else []
            else:
                takes = {True: f" -x -a {shlex.quote(' '.join(entry.words or ()))}", False: ""}[bool(entry.words)]
                lines.append(f"complete -c asg {here} -l {entry.name[2:]}" + (" -r" if entry.words is None else takes))
    return "\n".join(lines)


# The words of a list stand behind commas, too: only what follows the last comma is completed.
_BASH = """_asg() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" option="" words="" files="" i
  COMPREPLY=()
  if (( COMP_CWORD == 1 )); then
    COMPREPLY=($(compgen -W "{commands} --help --version" -- "$cur"))
    return
  fi
  for (( i = COMP_CWORD - 1; i > 1; i-- )); do
    if [[ "${{COMP_WORDS[i]}}" == --* ]]; then option="${{COMP_WORDS[i]}}"; break; fi
  done
  if [[ "${{COMP_WORDS[1]}}" == help ]]; then words="{commands}"; option=""; fi
  if [[ "$cur" != -* && -n "$option" ]]; then
    case "${{COMP_WORDS[1]}}:$option" in
{cases}
    esac
  fi
  if [[ -z "$words$files" ]]; then
    case "${{COMP_WORDS[1]}}" in
{alone}
    esac
  fi
  local before=""
  if [[ "$cur" == *,* ]]; then before="${{cur%,*}},"; cur="${{cur##*,}}"; fi
  COMPREPLY=($(compgen -P "$before" -W "$words" -- "$cur"))
  if [[ -n "$files" || ${{#COMPREPLY[@]}} -eq 0 ]]; then COMPREPLY+=($(compgen -f -- "$cur")); fi
}}
complete -o filenames -F _asg asg"""
