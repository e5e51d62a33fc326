"""``asg completion``: what a shell needs to complete commands, options, and the names that options take.

The names stand in the script, so that completing starts no Python; a plug-in that is installed later needs a new one.
"""

from __future__ import annotations

import shlex
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro

from activestructure_gym.evaluation.cli.commands import COMMANDS, find_command, parts_of
from activestructure_gym.streams import say


@dataclass(frozen=True)
class Completion:
    """Print a script that lets a shell complete commands, options and names.

    bash: eval "$(asg completion bash)" in ~/.bashrc; zsh: the same in ~/.zshrc after compinit; fish: asg completion
    fish > ~/.config/fish/completions/asg.fish
    """

    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.Positional]
    """The shell."""

    def run(self) -> int:
        """Print the script."""
        say({"bash": _bash, "zsh": _zsh, "fish": _fish}[self.shell]())
        return 0


@dataclass(frozen=True)
class _Entry:
    """An option or a positional argument, and the words it takes."""

    name: str  # "" for what stands alone
    words: Sequence[str] | None  # that it takes; () takes none, None is a file


@dataclass(frozen=True)
class _Place:
    """A command, or one of those that a command is split into: ``train``, ``train bc``."""

    words: tuple[str, ...]
    about: str
    entries: list[_Entry]
    parts: tuple[str, ...] = ()


def _places() -> Iterator[_Place]:
    names = _names()
    for command in COMMANDS:
        kind = find_command(command)
        parts = parts_of(kind)
        entries = [_Entry("--help", ()), _Entry("", tuple(parts))] if parts else _entries(kind, names)
        yield _Place((command,), _about(kind), entries, tuple(parts))
        for part, options in parts.items():
            yield _Place((command, part), _about(options), _entries(options, names))


def _about(kind: type) -> str:
    return (kind.__doc__ or "").partition("\n")[0].partition(";")[0]


def _entries(kind: type, names: Mapping[str, Sequence[str]]) -> list[_Entry]:
    entries = [_Entry("--help", ())]
    for name, hint in typing.get_type_hints(kind, include_extras=True).items():
        if typing.get_origin(hint) is typing.ClassVar:
            continue
        base, *about = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
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
    from activestructure_gym.evaluation.cli.config import leaves
    from activestructure_gym.features import FEATURES
    from activestructure_gym.mapping import MAPPERS
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.scenes import SCENES

    scenes, features = list(SCENES), list(FEATURES)
    return {
        "Policies.names": list(POLICIES),
        "Features.names": features,
        "Config.words": [
            *PRESETS,
            *dict.fromkeys(name.partition(".")[0] for name, _ in leaves(ReconstructionConfig())),
        ],
        "Scenes.spec": scenes,
        "set": [f"{name}=" for name, _ in leaves(ReconstructionConfig())],
        "policies": [*POLICIES, "ladder", "all"],
        "baseline": list(POLICIES),
        "scenes": scenes,
        "scene": scenes,
        "preset": list(PRESETS),
        "gains": features,
        "teacher": ["oracle", *features],
        "axes": ["opencv", "opengl", "habitat", "ros"],
        "mapper": list(MAPPERS),
        "mappers": list(MAPPERS),
        "engine": ["local", "inline", "ray"],
        "protocols": ["standard", "activegamer"],
        "protocol": ["standard", "activegamer"],
    }


def _bash() -> str:
    cases, alone, split = list[str](), list[str](), list[str]()
    for place in _places():
        where = " ".join(place.words)
        for entry in place.entries:
            option = shlex.quote(f"{where}:{entry.name}")
            if entry.name and entry.words:
                cases.append(f"    {option}) words={shlex.quote(' '.join(entry.words))} ;;")
            elif entry.name and entry.words is None:
                cases.append(f"    {option}) files=1 ;;")
        words = [entry.name for entry in place.entries if entry.name]
        words += [word for entry in place.entries if not entry.name for word in entry.words or ()]
        alone.append(f"    {shlex.quote(where)}) words={shlex.quote(' '.join(words))} ;;")
        split += place.words if place.parts else ()
    return _BASH.format(
        commands=" ".join((*COMMANDS, "help")),
        split="|".join(split),
        cases="\n".join(cases),
        alone="\n".join(alone),
    )


def _zsh() -> str:
    return "autoload -U +X bashcompinit && bashcompinit\n" + _bash()


def _fish() -> str:
    lines = ["complete -c asg -n __fish_use_subcommand -f"]
    places = list(_places())
    for place in places:
        about = shlex.quote(place.about)
        if len(place.words) == 1:
            lines.append(f"complete -c asg -n __fish_use_subcommand -a {place.words[0]} -d {about}")
        else:
            command, part = place.words
            first = next(
                f"not __fish_seen_subcommand_from {' '.join(p.parts)}" for p in places if p.words == (command,)
            )
            lines.append(
                f"complete -c asg -n '__fish_seen_subcommand_from {command}; and {first}' -a {part} -d {about}"
            )
        here = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in place.words)
        # `asg policies`, and not `asg bench policies`
        above = [other.words[0] for other in places if len(place.words) == 1 and place.words[0] in other.parts]
        here = f"-n '{here}{''.join(f'; and not __fish_seen_subcommand_from {word}' for word in above)}'"
        for entry in place.entries:
            if entry.name:
                takes = {True: f" -x -a {shlex.quote(' '.join(entry.words or ()))}", False: ""}[bool(entry.words)]
                lines.append(f"complete -c asg {here} -l {entry.name[2:]}" + (" -r" if entry.words is None else takes))
            elif entry.words and not place.parts:
                lines.append(f"complete -c asg {here} -a {shlex.quote(' '.join(entry.words))}")
    return "\n".join(lines)


# The words of a list stand behind commas, too: only what follows the last comma is completed.
_BASH = """_asg() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" command="${{COMP_WORDS[1]}}" option="" words="" files="" i
  COMPREPLY=()
  if (( COMP_CWORD == 1 )); then
    COMPREPLY=($(compgen -W "{commands} --help --version" -- "$cur"))
    return
  fi
  case "$command" in
    {split}) if (( COMP_CWORD > 2 )); then command+=" ${{COMP_WORDS[2]}}"; fi ;;
  esac
  for (( i = COMP_CWORD - 1; i > 1; i-- )); do
    if [[ "${{COMP_WORDS[i]}}" == --* ]]; then option="${{COMP_WORDS[i]}}"; break; fi
  done
  if [[ "$command" == help ]]; then words="{commands}"; option=""; fi
  if [[ "$cur" != -* && -n "$option" ]]; then
    case "$command:$option" in
{cases}
    esac
  fi
  if [[ -z "$words$files" ]]; then
    case "$command" in
{alone}
    esac
  fi
  local before=""
  if [[ "$cur" == *,* ]]; then before="${{cur%,*}},"; cur="${{cur##*,}}"; fi
  COMPREPLY=($(compgen -P "$before" -W "$words" -- "$cur"))
  if [[ -n "$files" || ${{#COMPREPLY[@]}} -eq 0 ]]; then COMPREPLY+=($(compgen -f -- "$cur")); fi
}}
complete -o filenames -F _asg asg"""
