"""The scripts complete commands, options and choices, as the shells themselves would."""

import shutil
import subprocess

import pytest

from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.commands import SHOWN, find_command, parts_of


@pytest.fixture(scope="module")
def bash_script():
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(["completion", "bash"]) == 0
    return out.getvalue()


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    "words, expected",
    [
        (["co"], {"compare", "completion"}),
        (["compare", "--pol"], {"--policies"}),
        (["list", ""], {"policies", "scenes", "worlds", "features", "config"}),
        (["train", ""], {"bc", "rank", "ppo", "eval"}),
        (["train", "bc", "--reward", ""], {"rate", "auc", "env"}),
        (["bench", "sp"], {"splatting"}),
    ],
)
def test_bash_completes(words, expected, bash_script, tmp_path):
    line = " ".join(f"'{word}'" for word in ("asg", *words))
    shown = "printf '%s\\n' \"${COMPREPLY[@]}\""
    ask = f"{bash_script}\nCOMP_WORDS=({line}); COMP_CWORD={len(words)}; _tyro_asg; {shown}"
    done = subprocess.run(["bash", "-c", ask], cwd=tmp_path, capture_output=True, text=True)
    assert not done.stderr
    assert expected <= set(done.stdout.split()) and len(done.stdout.split()) < 10, done.stdout


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_know_every_command_and_option(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    parts = [part for name in SHOWN for part in parts_of(find_command(name))]
    assert all(name in script for name in (*SHOWN, *parts, "lpips-weights", "no-baseline", "temperature"))
    if shutil.which(shell):
        assert subprocess.run([shell, "-n", "/dev/stdin"], input=script, text=True).returncode == 0
