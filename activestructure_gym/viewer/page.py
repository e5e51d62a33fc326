"""Make the viewer's page: one HTML file that contains the films, or requests live data, and loads nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

_ASSETS = Path(__file__).with_name("assets")
_TEMPLATES = Environment(
    loader=FileSystemLoader(_ASSETS), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
# The page loads and sends nothing, except to its live server, whatever text a scene's or policy's name contains.
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def viewer_page(title: str, films: Sequence[str] = (), *, live: bool = False) -> str:
    """Return the page: one film or two side by side, as base64 of deflated bytes, or a live episode."""
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
