"""Create the viewer's HTML page: one file without external resources that contains recordings or requests live data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

_ASSETS = Path(__file__).with_name("assets")
_TEMPLATES = Environment(
    loader=FileSystemLoader(_ASSETS), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
# Content security policy: the page loads and sends nothing, whatever text the name of a scene or policy contains. A
# live page may also connect to its own server.
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def viewer_page(title: str, films: Sequence[str] = (), *, live: bool = False, asks: bool = False) -> str:
    """Return the HTML page that shows ``films`` or, with ``live``, a running episode.

    ``films`` are one or two recordings, shown side by side, each as base64 text of deflated bytes. With ``asks``, the
    page shows all candidates at first, because the user chooses one of them.
    """
    scripts = ("unpack.js", "scene.js", "run.js", "chart.js", "player.js", "live.js" if live else "films.js")
    return _TEMPLATES.get_template("viewer.html.j2").render(
        policy=f"{_POLICY}; connect-src 'self'" if live else _POLICY,
        title=title,
        style=_asset("viewer.css"),
        scripts=[_asset(name) for name in scripts],
        films=[Markup(film) for film in films],
        live=live,
        asks=asks,
    )


def _asset(name: str) -> Markup:
    return Markup((_ASSETS / name).read_text(encoding="utf-8"))
