"""The page: one HTML file with the films or, live, with the way to ask for more, and nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

_ASSETS = Path(__file__).with_name("assets")
_TEMPLATES = Environment(
    loader=FileSystemLoader(_ASSETS), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
# Whatever a scene's or a policy's name may hold, the page loads nothing and sends nothing, but to who served it live.
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def viewer_page(title: str, films: Sequence[str] = (), *, live: bool = False) -> str:
    """The whole page: one film, or two side by side on one clock, as base64 of deflated bytes; or a live episode."""
    scripts = ("unpack.js", "scene.js", "player.js", "live.js" if live else "films.js")
    return _TEMPLATES.get_template("viewer.html.j2").render(
        policy=f"{_POLICY}; connect-src 'self'" if live else _POLICY,
        title=title,
        style=_asset("viewer.css"),
        scripts=[_asset(name) for name in scripts],
        films=[Markup(film) for film in films],
        live=live,
    )


def _asset(name: str) -> Markup:
    return Markup((_ASSETS / name).read_text(encoding="utf-8"))
