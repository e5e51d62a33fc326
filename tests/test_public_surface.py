"""What a user may import: on one screen, loaded when it is used, and every name with a page that says how to use it."""

from __future__ import annotations

import dataclasses
import doctest
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym.policies import POLICIES
from tests.bare_jobs import bare_jobs

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("", ".envs", ".policies", ".evaluation")


def room(name: str) -> Any:
    return importlib.import_module(f"activestructure_gym{name}")


def surface() -> list[tuple[str, str]]:
    return [(name, public) for name in ROOMS for public in room(name).__all__]


@pytest.mark.parametrize("name", ["", ".envs", ".evaluation"])
def test_a_name_that_is_not_there_is_an_attribute_error(name: str) -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = room(name).nothing


def test_every_name_is_there_once_and_sorted_by_its_list() -> None:
    for name in ROOMS:
        module = room(name)
        assert len(set(module.__all__)) == len(module.__all__)
        assert set(module.__all__) <= set(dir(module)) | set(getattr(module, "_MODULE_OF", ()))
        for public in module.__all__:
            getattr(module, public)


def test_a_room_fits_on_a_screen() -> None:
    for path in ("activestructure_gym", "envs", "policies", "evaluation"):
        assert len((ROOT / path / "__init__.py").read_text(encoding="utf-8").splitlines()) <= 120, path


@pytest.mark.parametrize(("name", "public"), surface())
def test_every_name_has_its_page(name: str, public: str) -> None:
    thing = getattr(room(name), public)
    if not (inspect.isfunction(thing) or inspect.isclass(thing)):
        return  # registries and constants stand in their room's page
    text = inspect.getdoc(thing) or ""
    assert text, public
    if dataclasses.is_dataclass(thing):
        unsaid = fields_without_words(thing)
        assert not unsaid or re.search(r"^(Parameters|Attributes)\n-+$", text, re.MULTILINE), f"{public}: {unsaid}"
        return
    if inspect.isclass(thing):
        if not issubclass(thing, Exception):
            pages = "\n".join(inspect.getdoc(one) or "" for one in thing.__mro__)
            for parameter in set(inspect.signature(thing).parameters) - {"options", "args", "kwargs"}:
                assert re.search(rf"^(``)?{parameter}\b|^\| `{parameter}` ", pages, re.MULTILINE), (
                    f"{public}: {parameter}?"
                )
        return
    signature = inspect.signature(thing)
    if signature.parameters:
        assert re.search(r"^Parameters\n-+$", text, re.MULTILINE), f"{public}: say what it takes"
        said = text[re.search(r"^Parameters\n-+$", text, re.MULTILINE).end() :]  # type: ignore[union-attr]
        for parameter in signature.parameters:
            assert re.search(rf"^(\w+, )*\**{parameter}\b", said, re.MULTILINE), f"{public}: say what {parameter} is"
    if signature.return_annotation not in (None, "None", inspect.Signature.empty):
        assert re.search(r"^(Returns|Yields)\n-+$", text, re.MULTILINE), f"{public}: say what it gives"


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_every_option_of_a_policy_has_its_words(name: str) -> None:
    kind = POLICIES.get(name)
    pages = "\n".join(inspect.getdoc(one) or "" for one in kind.__mro__)
    for parameter in inspect.signature(kind).parameters:
        assert re.search(rf"^(``)?{parameter}\b", pages, re.MULTILINE), f"{name}: {parameter}?"


def fields_without_words(kind: type) -> list[str]:
    """Fields of a dataclass with no comment beside them, above them, or docstring below."""
    lines = inspect.getsource(kind).splitlines()
    unsaid = []
    for field in dataclasses.fields(kind):
        at = next((n for n, line in enumerate(lines) if re.match(rf"    {field.name}:", line)), None)
        if at is None:
            continue  # of a class below
        near = lines[at : at + 2]
        if not ("#" in lines[at] or lines[at - 1].strip().startswith("#") or near[-1].strip().startswith('"""')):
            unsaid.append(field.name)
    return unsaid


def test_the_guide_names_them_all() -> None:
    page = ROOT / "docs" / "reference" / "api.md"
    if not page.is_file():
        pytest.skip("no page of the API")
    text = page.read_text(encoding="utf-8")
    missing = [public for _, public in surface() if not re.search(rf"\b{re.escape(public)}\b", text)]
    assert not missing, f"docs/reference/api.md lacks {missing}"


def examples() -> list[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True, recurse=False)
    found = [test for name in ROOMS for test in finder.find(room(name), room(name).__name__)]
    seen = set()
    for name, public in surface():
        thing = getattr(room(name), public)
        if id(thing) not in seen and (inspect.isfunction(thing) or inspect.isclass(thing)):
            seen.add(id(thing))
            source = importlib.import_module(thing.__module__)
            found += DEEP.find(thing, public, module=source, globs=dict(vars(source)))
    return [test for test in found if test.examples]


DEEP = doctest.DocTestFinder(exclude_empty=True)


@pytest.mark.parametrize("example", examples(), ids=lambda example: example.name)
def test_the_examples_do_what_they_say(example: doctest.DocTest) -> None:
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    with bare_jobs():
        outcome = runner.run(example, out=said.append)
    assert outcome.attempted and not outcome.failed, "".join(said)


def test_there_are_examples() -> None:
    assert len(examples()) >= 20
