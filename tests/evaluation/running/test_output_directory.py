"""A comparison writes only into a directory that is new, empty, or its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.running.output_directory import check_output


def test_an_output_that_is_not_ours_is_left_alone(tmp_path: Path) -> None:
    check_output(tmp_path / "new" / "deep", resume=False)
    check_output(tmp_path, resume=False)  # empty
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="is a file"):
        check_output(file, resume=False)
    with pytest.raises(InputError, match="other files"):
        check_output(tmp_path, resume=False)
    with pytest.raises(InputError, match="other files"):
        check_output(tmp_path, resume=True)
    (tmp_path / "compare.json").touch()
    with pytest.raises(InputError, match="--resume"):
        check_output(tmp_path, resume=False)
    check_output(tmp_path, resume=True)
    with pytest.raises(InputError, match="cannot be made: '.*file' is a file"):
        check_output(file / "below", resume=False)


@pytest.mark.skipif(os.name != "posix", reason="permission bits")
def test_an_output_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    code = (
        "import sys; from pathlib import Path;"
        "from activestructure_gym.evaluation.running.output_directory import check_output;"
        "check_output(Path(sys.argv[1]), resume=False)"
    )
    prefix = []
    if os.geteuid() == 0:  # permissions do not bind root, unless it gives that up
        if shutil.which("setpriv") is None:
            pytest.skip("no setpriv to give up root's rights")
        prefix = ["setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override"]
    command = [*prefix, sys.executable, "-c", code, str(tmp_path / "new")]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 1 and "InputError" in ended.stderr and "no permission" in ended.stderr


def test_an_output_that_no_file_can_be_made_in_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**given: str) -> None:
        raise OSError(2, "No such file or directory")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)  # as in /proc, of which the system says that it can be written
    with pytest.raises(InputError, match="cannot be written: No such file or directory in"):
        check_output(tmp_path / "new", resume=False)
