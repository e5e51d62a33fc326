"""The scripts complete commands, options and names, as the shells themselves would."""

import shutil
import subprocess

import pytest

from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.commands import COMMANDS, find_command, parts_of
from activestructure_gym.policies import POLICIES


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
        (["co"], {"compare", "config", "completion"}),
        (["help", "exp"], {"export"}),
        (["compare", "--pol"], {"--policies"}),
        (["compare", "--policies", "active_"], {"active_gs"}),
        (["compare", "--policies", "random", "lad"], {"ladder"}),
        (["compare", "--policies", "random,act"], {f"random,{name}" for name in POLICIES if name.startswith("act")}),
        (["compare", "--scenes", "b"], {"box"}),
        (["compare", "--preset", ""], {"fast", "default", "full", "paper"}),
        (["compare", "--set", "sensor.wi"], {"sensor.width="}),
        (["compare", "--out", "map"], {"map.ply"}),
        (["train", ""], {"--help", "bc", "rank", "ppo", "score"}),
        (["train", "bc", "--ga"], {"--gains", "--gamma"}),
        (["train", "score", "--ga"], set()),
        (["train", "bc", "--reward", ""], {"rate", "auc", "env"}),
        (["bench", "gr"], {"growth", "grid"}),
        (["bench", "policies", "--q"], {"--quick"}),
        (["train", "p"], {"ppo"}),
        (["train", "bc", "--no-"], {"--no-noise", "--no-planes-told"}),
        (["policies", "naru"], {"naruto"}),
        (["scenes", "apart"], {"apartment"}),
        (["cache", "cl"], {"clear"}),
        (["completion", "f"], {"fish"}),
        (["export", "ma"], {"map.ply"}),
    ],
)
def test_bash_completes(words, expected, bash_script, tmp_path):
    (tmp_path / "map.ply").touch()
    line = " ".join(f"'{word}'" for word in ("asg", *words))
    ask = f"{bash_script}\nCOMP_WORDS=({line}); COMP_CWORD={len(words)}; _asg; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(["bash", "-c", ask], cwd=tmp_path, capture_output=True, text=True)
    assert not done.stderr
    found = set(done.stdout.split())
    assert found == expected


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_know_every_command_and_option(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    parts = [part for name in COMMANDS for part in parts_of(find_command(name))]
    assert all(name in script for name in (*COMMANDS, *parts, "lpips-weights", "naruto", "no-baseline", "temperature"))
    if shutil.which(shell):
        assert subprocess.run([shell, "-n", "/dev/stdin"], input=script, text=True).returncode == 0
