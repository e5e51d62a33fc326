"""A cached file that somebody else can have written is not used."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import pytest

from activestructure_gym import owners
from activestructure_gym.errors import InputWarning
from activestructure_gym.owners import folder_of_others, guard, open_own

pytestmark = pytest.mark.skipif(os.name != "posix", reason="no numbers of users here")
NOBODY = 65534


@pytest.fixture(autouse=True)
def unsaid(monkeypatch):
    monkeypatch.setattr(owners, "_said", [])


@pytest.fixture
def kept(tmp_path) -> Path:
    (tmp_path / "code.py").touch(0o644)
    (tmp_path / "kept").write_bytes(b"content")
    (tmp_path / "kept").chmod(0o644)
    return tmp_path / "kept"


def code_of(kept: Path) -> str:
    return str(kept.with_name("code.py"))


def test_an_own_file_is_opened(kept):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with open_own(kept, code_of(kept)) as file:
            assert file.read() == b"content"


@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
def test_a_file_that_others_can_write_is_refused_and_that_is_said_once(kept, mode):
    kept.chmod(mode)
    with pytest.warns(InputWarning, match="another user: it and similar files are not used") as said:
        for _ in range(2):
            with pytest.raises(PermissionError):
                open_own(kept, code_of(kept))
    assert len(said) == 1
    kept.with_name("code.py").chmod(mode)  # on a drive of Windows all files are everybody's, and so is the code
    open_own(kept, code_of(kept)).close()


def test_links_pipes_and_folders_are_refused(kept):
    (kept.with_name("link")).symlink_to(kept)
    os.mkfifo(kept.with_name("pipe"))
    for place in (kept.with_name("link"), kept.with_name("pipe"), kept.parent, kept.with_name("nothing")):
        with warnings.catch_warnings(), pytest.raises(OSError):
            warnings.simplefilter("ignore")
            open_own(place, code_of(kept))


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_a_file_of_another_user_is_refused_unless_the_code_is_that_user_s(kept):
    os.chown(kept, NOBODY, NOBODY)
    with pytest.warns(InputWarning), pytest.raises(PermissionError):
        open_own(kept, code_of(kept))
    os.chown(code_of(kept), NOBODY, NOBODY)
    open_own(kept, code_of(kept)).close()
    os.chown(kept, 0, 0)
    open_own(kept, code_of(kept)).close()
    os.chown(code_of(kept), 0, 0)
    os.chown(kept.parent, NOBODY, NOBODY)
    assert folder_of_others([kept.parent], code_of(kept)) == kept.parent


def test_folders(kept):
    folder = kept.with_name("folder")
    folder.mkdir()
    for mode, refused in ((0o755, False), (0o775, False), (0o1777, False), (0o777, True)):
        folder.chmod(mode)
        found = folder_of_others([folder / "not there", folder, kept.parent], code_of(kept))
        assert found == (folder if refused else None), oct(mode)


def test_a_file_that_is_written_is_its_owner_s(kept):
    kept.chmod(0o666)
    with open(kept, "wb") as file:
        guard(file.fileno())
    assert kept.stat().st_mode & 0o777 == 0o644
