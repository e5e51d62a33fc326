"""What the guide shows is run as shown, and a newcomer reads it in an hour."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.bare_jobs import bare_jobs

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = {
    page.name: page for part in ("start", "howto", "reference", "explanation") for page in (DOCS / part).glob("*.md")
}
SHOWN = ("first_episode.md", "own_parts.md", "own_world.md", "run_format.md", "watching.md")


def blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGES[page].read_text(encoding="utf-8"), flags=re.DOTALL)


def shown() -> Iterator[Any]:
    """Every block of the pages above; one of them measures the whole of a run twice."""
    for page in SHOWN:
        for number in range(len(blocks(page))):
            slow = (page, number) == ("own_parts.md", 2)
            yield pytest.param(page, number, marks=[pytest.mark.slow] if slow else [])


@pytest.mark.parametrize(("page", "number"), list(shown()))
def test_what_a_page_shows_runs(page: str, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from activestructure_gym.evaluation.protocols import PROTOCOLS
    from activestructure_gym.evaluation.protocols.metrics import METRICS
    from activestructure_gym.evaluation.running.engines import ENGINES

    for registry in (PROTOCOLS, ENGINES, METRICS):
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    module = ModuleType("shown_in_the_guide")  # dataclasses look their module up
    monkeypatch.setitem(sys.modules, module.__name__, module)
    with bare_jobs():
        exec(compile(blocks(page)[number], f"{page}, block {number}", "exec"), module.__dict__)


def test_no_page_shows_python_that_no_test_runs() -> None:
    # By tests/test_docs.py and tests/examples.
    elsewhere = {"own_feature.md", "own_planner.md", "own_source.md", "training.md"}
    shown = {name for name in PAGES if blocks(name)}
    assert shown == elsewhere | set(SHOWN)


def test_the_guide_is_an_hour_of_reading() -> None:
    pages = {name: page.read_text(encoding="utf-8").split() for name, page in PAGES.items()}
    words = {name: sum(any(letter.isalnum() for letter in word) for word in text) for name, text in pages.items()}
    assert sum(words.values()) <= 14_000 and max(words.values()) <= 2_500
