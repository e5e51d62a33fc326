"""Define ``asg completion``, which prints tyro's script for the completion of commands and options in a shell."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union

import tyro

from activestructure_gym.evaluation.cli.commands import SHOWN, find_command
from activestructure_gym.evaluation.cli.parsing import VALUES
from activestructure_gym.streams import raw


@dataclass(frozen=True)
class Completion:
    """Print a script for completion in a shell.

    bash: eval "$(asg completion bash)" in ~/.bashrc; zsh: asg completion zsh > DIRECTORY/_asg, where DIRECTORY is in
    fpath; fish: asg completion fish > ~/.config/fish/completions/asg.fish
    """

    shell: Annotated[Literal["bash", "zsh", "fish", "tcsh"], tyro.conf.Positional]
    """Print the script for this shell."""

    def run(self) -> int:
        """Print the script."""
        parts = tuple(Annotated[find_command(name), tyro.conf.subcommand(name)] for name in SHOWN)
        commands: Any = Union[parts]  # noqa: UP007 (a union of a variable number of types)
        config = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
        try:
            with redirect_stdout(raw(sys.stdout)):
                tyro.cli(
                    commands, prog="asg", args=["--tyro-print-completion", self.shell], registry=VALUES, config=config
                )
        except SystemExit as end:
            return int(end.code or 0)
        return 0
