"""Define ``asg new``, which writes a template of a plug-in and its test."""

from __future__ import annotations

import importlib.util
import keyword
import re
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Annotated, Literal, get_args

import tyro

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import option
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.streams import escape

Kind = Literal["policy", "feature", "source", "world"]
_TEMPLATES = Path(__file__).with_name("templates")
_NEXT = {
    "policy": "asg compare --scenes room --policies random,{name}:{title}",
    "feature": "asg list features {name}:{name}",
    "source": "asg watch --set 'views.stages=[[\"{name}:{title}\"]]'",
    "world": "asg explore --world {name}:{title} --frames 100",
}


@dataclass(frozen=True)
class New:
    """Write a template of a plug-in and its test.

    A plug-in is a policy, a feature, a candidate source or a world. Both files are written into the working directory.
    The test passes before you change the template.
    """

    kind: Annotated[Kind, tyro.conf.Positional, option("policy|feature|source|world")]
    """Write this kind of plug-in."""
    name: Annotated[str, tyro.conf.Positional, option("NAME")]
    """Name the module NAME.py, with lower-case letters, digits and underscores."""

    def run(self) -> int:
        """Write ``NAME.py`` and ``test_NAME.py``, and print the next commands; return 0."""
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.name) or keyword.iskeyword(self.name):
            raise InputError(
                "NAME is the name of a Python module, with lower-case letters, digits and underscores, got "
                f"'{self.name}'"
            )
        files = {f"{self.name}.py": f"{self.kind}.py.txt", f"test_{self.name}.py": f"test_{self.kind}.py.txt"}
        for file in files:
            if Path(file).exists():
                raise InputError(f"'{file}' exists already: choose another name, or another directory")
        if (found := importlib.util.find_spec(self.name)) is not None:
            raise InputError(
                f"'{self.name}' would hide a module of the same name, {found.origin or 'a folder'}: choose another name"
            )
        words = {"name": self.name, "title": "".join(part.capitalize() for part in self.name.split("_"))}
        for file, template in files.items():
            text = Template((_TEMPLATES / template).read_text(encoding="utf-8")).substitute(words)
            Path(file).write_text(text, encoding="utf-8")
        console = make_console()
        console.print(escape(f"written: {', '.join(files)}"))
        console.print("Next:")
        console.print(escape(f"  python -m pytest test_{self.name}.py"))
        console.print(escape(f"  {_NEXT[self.kind].format(**words)}"))
        return 0


assert set(_NEXT) == set(get_args(Kind))
