"""The page of a replay: one HTML file with the recordings, the script that draws them, and nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from activestructure_gym.evaluation.replay.packing import pack
from activestructure_gym.evaluation.replay.recording import Recording
from activestructure_gym.files import replaced

_ASSETS = Path(__file__).with_name("assets")
_TEMPLATES = Environment(
    loader=FileSystemLoader(_ASSETS), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
# Whatever a scene's or a policy's name may hold, the page loads nothing and sends nothing.
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def replay_page(recordings: Sequence[Recording]) -> str:
    """The whole page: one recording, or two side by side on one clock."""
    names = [f"{one.run.policy} · {one.run.scene} · seed {one.run.job.seed}" for one in recordings]
    return _TEMPLATES.get_template("replay.html.j2").render(
        policy=_POLICY,
        title=" against ".join(names),
        style=_asset("replay.css"),
        scripts=[_asset(name) for name in ("unpack.js", "scene.js", "replay.js")],
        recordings=[Markup(pack(one)) for one in recordings],
    )


def write_replay(recordings: Sequence[Recording], path: Path) -> int:
    """Write the page, whole or not at all; returns its bytes."""
    page = replay_page(recordings).encode()
    with replaced(path) as file:
        file.write(page)
    return len(page)


def _asset(name: str) -> Markup:
    return Markup((_ASSETS / name).read_text(encoding="utf-8"))
