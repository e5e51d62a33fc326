"""The documentation site: its generated pages, the commands it shows, and the workflow that would publish it."""

from __future__ import annotations

import dataclasses
import html
import importlib
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml
from packaging.utils import canonicalize_name
from PIL import Image

from activestructure_gym.config import ReconstructionConfig
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import COMMANDS, SHOWN, find_command, parts_of
from activestructure_gym.evaluation.cli.config import leaves
from activestructure_gym.evaluation.cli.parsing import parse
from activestructure_gym.policies import POLICIES
from activestructure_gym.scenes import SceneMesh, load_scene
from tests.requirements import closure, ours

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
GUIDE = ("start", "howto", "reference", "explanation")
PAGES = [
    *(page for name in GUIDE for page in sorted((DOCS / name).glob("*.md"))),
    *sorted(DOCS.glob("*.md")),
    ROOT / "README.md",
]


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(DOCS))
    return importlib.import_module("_site.policies")


def test_every_policy_has_a_page_with_the_words_of_its_folder(site: ModuleType) -> None:
    pages = site.pages()
    assert set(pages) == {"policies/index.md", "policies/short.txt", *(f"policies/{name}.md" for name in POLICIES)}
    folders = ROOT / "policies"
    assert len([*folders.glob("*/README.md")]) > 20
    for name, folder in (("naruto", "naruto"), ("popgs_logdet_cov", "popgs"), ("learned", "learned")):
        said = (folders / folder / "README.md").read_text(encoding="utf-8").splitlines()[2]
        assert said in pages[f"policies/{name}.md"]
    links = re.findall(r"\]\(((?!https?:)[^)#]+)", "".join(pages[f"policies/{name}.md"] for name in POLICIES))
    assert links and all((DOCS / "_made" / "policies" / link).resolve().is_file() for link in links)
    told = json.loads(site.CURVES.read_text(encoding="utf-8"))
    assert set(told["policies"]) <= set(POLICIES)
    drawn = {name for name in POLICIES if "<svg" in pages[f"policies/{name}.md"]}
    assert drawn == set(told["policies"]) and len(drawn) >= 30


def rows(pages: dict[str, str]) -> dict[str, list[str]]:
    """The cells of the table of all policies as text, by policy."""
    table = [
        re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr data-kind.*", pages["policies/index.md"])
    ]
    return {re.findall(r'href="([\w-]+)\.html"', cells[0])[0]: cells for cells in table}


def test_the_table_of_policies_has_source_rule_cost_and_the_numbers_of_the_csv(site: ModuleType) -> None:
    pages = site.pages()
    table = rows(pages)
    assert set(table) == set(POLICIES)
    runs = runpy.run_path(str(DOCS / "notebook" / "benchmark_table.py"))["all_policies"]()
    for name in ("random", "unseen", "fisherrf", "learned"):
        cells = runs[name]
        assert len(cells) == 6
        for column, key in enumerate(site.COLUMNS, 2):
            if key != site.COST:
                expected = format(np.mean([run[key] for run in cells.values()]), site.FORMATS[key])
                assert table[name][column] == expected
                assert f" {expected} |" in pages[f"policies/{name}.md"]
    for name, cells in table.items():
        assert html.escape(POLICIES.get(name).source, quote=False) in cells[1] and float(cells[5] or 1) > 0
    psnr = [float(cells[4]) for cells in table.values() if cells[4]]
    assert psnr == sorted(psnr, reverse=True) and len(psnr) >= 30
    for kind, name in re.findall(r'<tr data-kind="(\w+)">.*?value="([\w-]+)"', pages["policies/index.md"]):
        assert kind == site.kind_of(POLICIES.get(name))
    names = ("naruto", "activestructure-b", "unseen", "learned")
    assert [site.kind_of(POLICIES.get(name)) for name in names] == ["published", "ActiveStructure", "ours", "learned"]
    short = [line.split(" | ") for line in pages["policies/short.txt"].splitlines()[2:]]
    told = (ROOT / "README.md").read_text(encoding="utf-8")
    assert {name for name, *_ in short} == {f"| [`{name}`](_made/policies/{name}.md)" for name in site.HOME}
    for name, _, observed, ratio, psnr in short:  # the home page and README have the same numbers
        (row,) = re.findall(rf"^\| {name[3 : name.index(']')]}.*", told, re.MULTILINE)
        assert [row.split(" | ")[column] for column in (1, 3, 4)] == [observed, ratio, psnr.strip(" |")]
    assert [float(psnr.strip(" |")) for *_, psnr in short] == sorted(float(row[4].strip(" |")) for row in short)[::-1]


def test_the_table_says_what_a_policy_maximises(site: ModuleType) -> None:
    pages = site.pages()
    said = {name: re.findall("<code>(.*?)</code>", cells[1]) for name, cells in rows(pages).items()}
    assert said["naruto"] == ["g* = argmax S(g), where S(g) is the sum of sigma(t) over the targets t seen from g"]
    assert said["pixel_only"] == ["argmax IG_px / (1 + frames / 5): Eq. 15 with omega = 0 and rho = 0"]
    assert "### `unknown_volume`\n\n" in pages["policies/unknown_volume.md"]  # it asks for a column of that


def test_no_page_compares_a_policy_with_itself(site: ModuleType) -> None:
    for name, text in site.pages().items():
        for names in re.findall(r"--policies (\S+)", text):
            assert len(set(names.split(","))) == len(names.split(",")), name


@dataclasses.dataclass
class Kettle:
    """One."""

    litres: float = 1.5  # filled
    # Said above:
    # twice
    whistles: bool = True
    parts: list[str] = dataclasses.field(default_factory=list)
    """Said
    below."""
    colour: str | None = None


def test_fields_are_told_with_the_comments_beside_them(site: ModuleType) -> None:
    reference = importlib.import_module("_site.reference")
    assert reference.field_words(Kettle) == [
        ("litres", "float", "1.5", "filled"),
        ("whistles", "bool", "True", "Said above: twice"),
        ("parts", "list[str]", "list", "Said below."),
        ("colour", "str | None", "None", ""),
    ]
    assert reference.escaped("a*b `c|d*` [n] x|y") == r"a\*b `c\|d*` \[n\] x\|y"


def pour(
    cups: list[float],  # [n] litres
    slowly: bool = False,
    *,
    sugar: int = 0,  # lumps, 0..2
) -> list[float]:  # [n]
    return [] if slowly else cups[sugar:]


def stir(cups: list[float]) -> float:  # [n] -> rounds per minute
    return sum(cups)


def test_shapes_and_units_are_told_that_stand_in_comments(site: ModuleType) -> None:
    module = importlib.import_module("_site.shapes")
    assert module.shapes(pour) == [("cups", "[n] litres"), ("sugar", "lumps, 0..2"), ("", "returns [n]")]
    assert module.shapes(stir) == [("", "[n] -> rounds per minute")] and module.shapes(Kettle) == []
    lines = ["Pours."]
    module.add_shapes(None, "function", "pour", pour, None, lines)
    module.add_shapes(None, "class", "pour", pour, None, lines)
    assert lines == ["Pours.", "", "Shapes and units: ``cups`` [n] litres; ``sugar`` lumps, 0..2; returns [n].", ""]


def test_everything_that_may_be_imported_has_one_entry(site: ModuleType) -> None:
    reference = importlib.import_module("_site.reference")
    text = "\n".join(reference.pages().values())
    made = re.findall(r"^\.\. auto\w+:: ([\w.]+)", text, re.MULTILINE)
    by_hand = re.findall(r"^\.\. py:\w+:: (\w+)\n   :module: ([\w.]+)", text, re.MULTILINE)
    made += [f"{room}.{name}" for name, room in by_hand]
    assert set(reference.entries().values()) <= set(made) and len(made) == len(set(made))
    assert reference.entries()["activestructure_gym.policies.base.Policy"] == "activestructure_gym.policies.Policy"
    assert "| `seed_spacing` | `float \\| None` | `0.045` | " in text


def test_every_command_has_a_page_with_all_its_options(site: ModuleType) -> None:
    module = importlib.import_module("_site.commands")
    pages = module.pages()
    assert set(pages) == {"cli/index.md", *(f"cli/{name}.md" for name in SHOWN)}
    for name in SHOWN:
        kind = find_command(name)
        assert f"[`asg {name}`]({name}.md): " in pages["cli/index.md"]
        for part in parts_of(kind) or ("",):
            options = module.options(module.help_of(name, *part.split()))
            named = [field.name for field in dataclasses.fields(parts_of(kind)[part] if part else kind)]
            assert len(options) == len(named) and all(said for _, said in options), (name, part)
            for option, _ in options:
                assert f"\n| {module.escaped(f'`{option}`')} | " in pages[f"cli/{name}.md"]


def test_options_in_a_sentence_are_code(site: ModuleType) -> None:
    module = importlib.import_module("_site.commands")
    assert module._marked("with --out, `asg x --help` | 2--3") == r"with `--out`, `asg x --help` \| 2--3"


def test_every_field_of_the_configuration_is_listed(site: ModuleType) -> None:
    text = importlib.import_module("_site.configuration").pages()["configuration/index.md"]
    for name, _ in leaves(ReconstructionConfig()):
        assert f"\n| `{name}` | " in text
    assert "| `sensor.width` | `96` | `96` | `160` | `320` | `1200` |" in text


def test_pages_about_the_project_link_into_the_site(site: ModuleType) -> None:
    pages = importlib.import_module("_site.about").pages()
    links = re.findall(r"\]\(([^)#]+)", "".join(pages.values()))
    assert "../../start/own_policy.md" in links
    assert all("://" in link or (DOCS / "_made" / "about" / link).resolve().exists() for link in links)


def test_every_environment_has_a_page_that_makes_it_and_a_film_made_once(
    site: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environments = importlib.import_module("_site.environments")
    made: list[str] = []

    def play(task: str, path: Path) -> None:
        made.append(task)
        path.touch()

    monkeypatch.setattr(environments, "_play", play)
    pages = environments.pages(tmp_path)
    assert set(pages) == {"environments/index.md", *(f"environments/{task.lower()}.md" for task in environments.TASKS)}
    for task in environments.TASKS:
        (block,) = re.findall(r"```python\n(.*?)```", pages[f"environments/{task.lower()}.md"], re.DOTALL)
        shown: dict[str, Any] = {}
        exec(compile(block.replace('"..."', '"box"'), task, "exec"), shown)
        assert shown["env"].spec.id == f"{environments.NAMESPACE}/{task}"
        shown["env"].close()
        pictures = re.findall(r"- \[!\[.*?\]\((.*?)\)\]\(", pages["environments/index.md"])
    assert len(pictures) == len(environments.TASKS) and all(
        (tmp_path / "environments" / name).is_file() for name in pictures
    )
    # A dataset's page has the film of a mesh from a file, and says so.
    for name in ("Replica", "Matterport3D"):
        page = pages[f"environments/{name.lower()}-v0.md"]
        assert "{figure} mesh-v0-" in page and f"Scenes of {name} may not be published here" in page
    # A world has no ground truth, so its film has another curve.
    for task, curve in (("Room-v0", "observed surface"), ("World-v0", "known space")):
        caption = f"with preset `fast`: their maps grow along the camera's path, with the {curve} below."
        assert caption in pages[f"environments/{task.lower()}.md"]
    assert environments.pages(tmp_path) == pages and made == list(environments.SHOWN_IN)
    monkeypatch.setattr(environments, "_code", lambda: "other")
    films = {path.name for path in tmp_path.rglob("*.webp")}
    assert environments.pages(tmp_path) != pages and made == 2 * list(environments.SHOWN_IN)
    assert len(films) == len(made) // 2 and films.isdisjoint(path.name for path in tmp_path.rglob("*.webp"))


def test_a_scene_goes_through_a_gltf_file(site: ModuleType, tmp_path: Path) -> None:
    """Read again it has the same triangles, textures and, to half a step of 255, colours."""
    mesh_file = importlib.import_module("_site.mesh_file")
    mesh = load_scene("box").mesh
    mesh_file.write_glb(mesh, tmp_path / "box.glb")
    again = load_scene(f"mesh:{tmp_path / 'box.glb'}?up=y").mesh
    np.testing.assert_allclose(centres(again)[0], centres(mesh)[0], atol=1e-5)
    np.testing.assert_allclose(centres(again)[1], np.clip(centres(mesh)[1], 0, 1), atol=0.002)
    assert len(again.textures) == len(mesh.textures) > 0


def centres(mesh: SceneMesh) -> tuple[np.ndarray, np.ndarray]:  # [F, 3] metres, [F, 3] sRGB
    """Middles of the triangles in the order of their places, and the colours of the vertices there."""
    places = mesh.vertices[mesh.faces].mean(axis=1).astype(np.float64)
    colors = mesh.colors[mesh.faces].mean(axis=1).astype(np.float64)
    if mesh.linear_colors:
        colors = np.where(colors <= 0.0031308, colors * 12.92, 1.055 * colors ** (1 / 2.4) - 0.055)
    order = np.lexsort(np.round(places, 4).T)
    return places[order], colors[order]


def test_links_out_of_the_docs_become_names_and_others_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    links = importlib.import_module("_site.links")
    text = [
        "[play](../../examples/00_play.py) [page](compare.md#native-setup) [gone](../../nowhere.py) "
        "[far](https://a.b/c.md) ![picture](../../docs/images/wall.jpg)"
    ]
    links.outside_links(None, "start/index", text)
    assert text[0] == (
        "play [page](compare.md#native-setup) [gone](../../nowhere.py) [far](https://a.b/c.md) "
        "![picture](../../docs/images/wall.jpg)"
    )


def test_papers_and_programs_of_the_bibliography_are_links_whose_check_says_what_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    links = importlib.import_module("_site.links")
    text = ["A. *B.* arXiv\n  2312.02126. Code: `a-b/C`, in it `src/d.py`."]
    links.named_links(None, "start/index", text)
    assert "](" not in text[0]
    links.named_links(None, "references", text)
    assert text[0] == (
        "A. *B.* [arXiv 2312.02126](https://arxiv.org/abs/2312.02126). "
        "Code: [`a-b/C`](https://github.com/a-b/C), in it `src/d.py`."
    )

    def asked(uri: str, status: str) -> str:
        return json.dumps({"uri": uri, "status": status, "info": "gone"})

    lines = [asked("https://a", "working"), asked("https://a", "working"), asked("#b", "unchecked")]
    assert links.summary(lines) == ("1 links to elsewhere: 1 answered, 0 did not", True)
    lines += [asked("https://c", "broken"), asked("https://d", "redirected"), asked("https://e", "ignored")]
    assert links.summary(lines) == (
        "4 links to elsewhere: 2 answered, 1 did not, 1 were not asked\nhttps://c: gone",
        False,
    )
    assert not links.summary([])[1]  # who asks nobody has checked nothing


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_within_sentences_have_their_options(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in re.findall(r"(?<!`)`asg ([a-z][^`|]*)`(?!`)", page.read_text(encoding="utf-8")):
        name, *rest = (word for word in words.split() if word != "...")
        try:
            parse(find_command(name), name, rest)
        except SystemExit:  # a sentence may leave away what must be given, as in `asg train --resume`
            assert "Unrecognized" not in capsys.readouterr().err, words
        except InputError as error:  # the same for the value of a list, as in `asg compare --policies`
            assert "lacks a value" in str(error), words


@pytest.mark.parametrize("path", sorted((ROOT / ".github" / "workflows").glob("*.yml")), ids=lambda path: path.stem)
def test_workflows_read_only_and_name_actions_by_commit(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert yaml.safe_load(text)["permissions"] == {"contents": "read"} and "secrets." not in text
    steps = [step for job in yaml.safe_load(text)["jobs"].values() for step in job["steps"]]
    for step in steps:
        assert "run" in step or re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step["uses"])
        if step.get("uses", "").startswith("actions/checkout"):
            assert step["with"]["persist-credentials"] is False
    # Beside each commit stands its version, one per action.
    named = re.findall(r"uses: ([\w/-]+@\w+)  # (v\d+\.\d+\.\d+)$", text, re.MULTILINE)
    assert len(named) == text.count("uses:") and len({action for action, _ in named}) == len(
        {action.partition("@")[0] for action, _ in named}
    )


def test_pull_requests_are_checked_on_every_python_that_is_promised() -> None:
    content = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8"))
    assert {"push", "pull_request", "schedule"} <= content[True].keys()  # YAML reads `on` as a truth value
    check = content["jobs"]["check"]
    assert check["steps"][-1]["run"] == ".ci/run" and os.access(ROOT / ".ci" / "run", os.X_OK)
    promised = set(re.findall(r"Python :: (3\.\d+)", (ROOT / "setup.cfg").read_text(encoding="utf-8")))
    assert promised and promised <= set(check["strategy"]["matrix"]["python"])


def test_the_workflow_publishes_with_the_least_rights() -> None:
    text = (ROOT / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    rights = {name: job.get("permissions") for name, job in jobs.items()}
    assert rights == {
        "site": None, "distributions": None, "pages": {"pages": "write", "id-token": "write"},
        "pypi": {"id-token": "write"},
    }  # fmt: skip
    for name, job in jobs.items():
        needed = job.get("needs", [])
        assert set([needed] if isinstance(needed, str) else needed) <= set(jobs), name
        for step in job["steps"]:
            if step.get("uses", "").startswith("pypa/"):
                assert step["with"] == {"attestations": True}  # and no password
        # Who may publish runs nothing of the repository.
        assert not job.get("permissions") or not any("run" in step for step in job["steps"])
    scripts = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert any("docs/build" in script for script in scripts) and os.access(DOCS / "build", os.X_OK)


def listed(page: str) -> list[str]:
    """The pages in the toctrees of a page, and those below them, without those that are made from the code."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    found = []
    for name in re.findall(
        r"^(/?[\w-]+(?:/[\w-]+)*)$", "".join(re.findall(r"{toctree}(.*?)```", text, re.DOTALL)), re.MULTILINE
    ):
        place = name[1:] if name.startswith("/") else (Path(page).parent / name).as_posix()
        found += [] if place.startswith("_made/") else [place, *listed(place)]
    return found


def test_every_page_has_one_place_in_the_navigation() -> None:
    pages = [
        path for path in DOCS.rglob("*.md") if path.relative_to(DOCS).parts[0] not in ("_made", "package_index.md")
    ]
    assert sorted(["index", *listed("index")]) == sorted(
        path.relative_to(DOCS).with_suffix("").as_posix() for path in pages
    )


ALONE = """
import importlib.abc, sys

class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocked())
sys.path[:0] = [DOCS, ROOT]
import sphinx, furo, myst_parser  # the extra is there
import conf, _site
from _site import about, commands, configuration, environments, links, mesh_file, policies, reference, shapes
pages = about.pages() | commands.pages() | configuration.pages() | policies.pages() | reference.pages()
assert "policies/random.md" in pages and "reference/activestructure_gym.policies.learned.md" in pages
"""


@pytest.mark.slow
def test_the_site_asks_for_nothing_but_its_extra() -> None:
    """Its pages are made although no package can be imported that the extra `docs` alone does not bring."""
    pytest.importorskip("sphinx", reason="pip install 'activestructure-gym[docs]'")
    brought = set(closure(ours("docs"))) | {"activestructure-gym"}
    blocked = [
        module
        for module, owners in metadata.packages_distributions().items()
        if not brought & {canonicalize_name(owner) for owner in owners}
    ]
    assert {"ray", "pytest", "skimage", "tensorboard"} & set(blocked)
    code = f"BLOCKED, DOCS, ROOT = {set(blocked)!r}, {str(DOCS)!r}, {str(ROOT)!r}\n{ALONE}"
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr[-3000:]


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
    for name in ("index", "start/first_episode", "_made/policies/naruto", "_made/environments/room-v0"):
        assert (tmp_path / "site" / f"{name}.html").stat().st_size > 5000
    page = (tmp_path / "site" / "_made" / "environments" / "room-v0.html").read_text(encoding="utf-8")
    (picture,) = re.findall(r'src="([^"]+\.webp)"', page)
    film = (tmp_path / "site" / "_made" / "environments" / picture).resolve()
    with Image.open(film) as shown:
        assert shown.size == (1200, 686) and film.stat().st_size < 1.5e6  # two maps side by side
    # Nothing is loaded from elsewhere.
    assert not re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="https?://', page)
