"""The documentation site: its generated pages, the commands it shows, and the workflow that would publish it."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from activestructure_gym.evaluation.cli.commands import COMMANDS, find_command
from activestructure_gym.evaluation.cli.parsing import parse
from activestructure_gym.policies import POLICIES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [*sorted((DOCS / "guide").glob("*.md")), *sorted(DOCS.glob("*.md")), ROOT / "README.md"]


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(DOCS))
    return importlib.import_module("_site.gallery")


def test_every_policy_has_a_page_and_a_section_that_is_there(site: ModuleType) -> None:
    pages = site.pages()
    assert set(pages) == {"policies/index.md", *(f"policies/{name}.md" for name in POLICIES)}
    guide = (DOCS / "guide" / "planners.md").read_text(encoding="utf-8")
    headings = {
        re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-")
        for line in re.findall(r"^## (.*)$", guide, re.MULTILINE)
    }
    linked = {name: re.findall(r"planners\.md#([\w-]+)", text) for name, text in pages.items()}
    assert all(set(anchors) <= headings for anchors in linked.values())
    assert (
        linked["policies/naruto.md"] == ["naruto"]
        and linked["policies/popgs_logdet_cov.md"] == linked["policies/popgs_logdet.md"]
    )
    told = json.loads(site.CURVES.read_text(encoding="utf-8"))
    assert set(told["policies"]) <= set(POLICIES)
    drawn = {name for name in POLICIES if "<svg" in pages[f"policies/{name}.md"]}
    assert drawn == set(told["policies"]) and len(drawn) >= 30
    places = [pages["policies/index.md"].index(f"<strong>{name}<") for name in ("hole_area", "pixel_only", "random")]
    assert places == sorted(places)  # who observed more comes first


def test_links_out_of_the_docs_become_names_and_others_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    links = importlib.import_module("_site.links")
    text = [
        "[play](../../examples/play.py) [page](compare.md#native-terms) [gone](../../nowhere.py) "
        "[far](https://a.b/c.md) ![picture](../../docs/images/wall.jpg)"
    ]
    links.outside_links(None, "guide/index", text)
    assert text[0] == (
        "play [page](compare.md#native-terms) [gone](../../nowhere.py) [far](https://a.b/c.md) "
        "![picture](../../docs/images/wall.jpg)"
    )


def commands(page: Path) -> list[str]:
    found = []
    for block in re.findall(r"```bash\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL):
        found += [line for line in block.replace("\\\n", " ").splitlines() if line.startswith("asg ")]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_that_is_shown_has_the_options_it_is_shown_with(page: Path) -> None:
    for line in commands(page):
        words = shlex.split(line, comments=True)
        words = words[: min((words.index(mark) for mark in ("|", ">", "&&", "&") if mark in words), default=len(words))]
        if words[1].startswith("-") or words[1] == "COMMAND":
            continue
        assert words[1] in COMMANDS, line
        try:
            parse(find_command(words[1]), words[1], words[2:])
        except SystemExit as end:  # it is help that is shown
            assert end.code in (None, 0), line


def test_the_workflow_publishes_with_the_least_rights_and_no_secret() -> None:
    text = (ROOT / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    assert yaml.safe_load(text)["permissions"] == {"contents": "read"} and "secrets." not in text
    rights = {name: job.get("permissions") for name, job in jobs.items()}
    assert rights == {
        "site": None, "distributions": None, "pages": {"pages": "write", "id-token": "write"},
        "pypi": {"id-token": "write"},
    }  # fmt: skip
    for name, job in jobs.items():
        needed = job.get("needs", [])
        assert set([needed] if isinstance(needed, str) else needed) <= set(jobs), name
        for step in job["steps"]:
            assert "run" in step or re.fullmatch(r"[\w-]+/[\w-]+@[\w./]+", step["uses"])
            if step.get("uses", "").startswith("actions/checkout"):
                assert step["with"]["persist-credentials"] is False
        # Who may publish runs nothing of the repository.
        assert not job.get("permissions") or not any("run" in step for step in job["steps"])
    scripts = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert any("docs/build" in script for script in scripts) and os.access(DOCS / "build", os.X_OK)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("sphinx", reason="pip install 'activestructure-gym[docs]'")
    told = subprocess.run(
        [str(DOCS / "build"), str(tmp_path / "site")],
        env={**os.environ, "PYTHON": sys.executable},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stdout[-2000:] + told.stderr[-4000:]
    for name in ("index", "guide/first_episode", "_made/policies/naruto", "_made/environments/room-v0"):
        assert (tmp_path / "site" / f"{name}.html").stat().st_size > 5000
    page = (tmp_path / "site" / "_made" / "environments" / "room-v0.html").read_text(encoding="utf-8")
    (picture,) = re.findall(r'src="([^"]+\.webp)"', page)
    assert (tmp_path / "site" / "_made" / "environments" / picture).resolve().is_file()
    # Nothing is loaded from elsewhere.
    assert not re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="https?://', page)
