"""What a package index and a stranger without the repository get: metadata, long description, source distribution."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import sys
import tarfile
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest
import yaml

from activestructure_gym._version import __version__

ROOT = Path(__file__).resolve().parents[1]


def tracked() -> list[str]:
    """The repository's files; skips where this is no repository."""
    listed = subprocess.run(["git", "ls-files"], capture_output=True, text=True, cwd=ROOT)
    if listed.returncode:
        pytest.skip("not a git checkout")
    return listed.stdout.split("\n")[:-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The source distribution by name, built from the tracked files alone."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("sdist")
    for name in tracked():
        if (ROOT / name).exists():  # a file may be deleted and not committed yet
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            if (ROOT / name).is_dir():  # a link to a folder
                (source / name).symlink_to((ROOT / name).readlink())
            else:
                shutil.copyfile(ROOT / name, source / name)
    build = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"
    subprocess.run([sys.executable, "-c", build, str(out)], cwd=source, check=True, capture_output=True)
    (archive,) = out.glob("*.tar.gz")
    with tarfile.open(archive) as files:
        return {
            member.name.partition("/")[2]: files.extractfile(member).read()  # type: ignore[union-attr]
            for member in files.getmembers()
            if member.isfile()
        }


@pytest.fixture(scope="module")
def metadata(sdist: dict[str, bytes]) -> Message:
    return Parser().parsestr(sdist["PKG-INFO"].decode())


def packed(name: str) -> str:
    """Where the source distribution has a file: code at the top of the repository is in the package, once."""
    return f"activestructure_gym/{name}" if name.startswith(("envs/", "policies/", "evaluation/")) else name


def test_the_source_distribution_is_the_repository_once(sdist: dict[str, bytes]) -> None:
    names = {packed(name) for name in tracked() if (ROOT / name).is_file()}
    missing = names - sdist.keys() - {".gitignore"}
    assert not missing, f"say so in MANIFEST.in: {sorted(missing)[:5]}"
    made = {name for name in sdist.keys() - names if ".egg-info/" not in name}
    assert made == {"PKG-INFO"}


def test_data_of_others_is_installed_with_its_licence() -> None:
    """setup.cfg names every data file, and a folder with data of others has its licence."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    packed = config["options.package_data"]["activestructure_gym.scenes.loaders"].split()
    assert packed == ["procthor_assets/*"]
    folder = ROOT / "activestructure_gym" / "scenes" / "loaders" / "procthor_assets"
    assert {file.name for file in folder.iterdir()} == {"LICENSE.txt", "sizes.txt"}
    assert "Apache License" in (folder / "LICENSE.txt").read_text(encoding="utf-8")
    head = (folder / "sizes.txt").read_text(encoding="utf-8").split("\n", 3)[:3]
    assert "allenai/procthor" in head[1] and "Apache-2.0" in head[2]
    assert (folder / "sizes.txt").stat().st_size < 60_000


def test_an_index_can_show_the_description(metadata: Message) -> None:
    text = str(metadata.get_payload())
    assert metadata["Description-Content-Type"] == "text/markdown" and "asg compare" in text
    for target in re.findall(r"\]\(([^)]+)\)", text):
        assert target.startswith("https://"), f"an index has no file {target}"


def test_the_metadata_says_who_what_and_where(metadata: Message) -> None:
    assert metadata["Version"] == __version__ and metadata["Author"] and metadata["Summary"] and metadata["Keywords"]
    assert metadata["License-Expression"] == "MIT" or metadata["License"] == "MIT"
    classifiers = metadata.get_all("Classifier", [])
    assert {"Typing :: Typed", "Programming Language :: Python :: 3.13"} <= set(classifiers)


def test_the_citation_names_this_version_and_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__ and citation["cff-version"] == "1.2.0" and citation["authors"]
    (paper,) = citation["references"]
    assert paper["title"] in (ROOT / "README.md").read_text(encoding="utf-8")
