"""``asg scenes``: list the registered scenes, or check one."""

from __future__ import annotations

import inspect
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.cli.fields import PathName, Switch, option
from activestructure_gym.evaluation.cli.listing import print_json
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.streams import escape

_MOST_BOTTOMLESS = 0.1  # share of the free space; small holes are in every scan


@dataclass(frozen=True)
class Scenes:
    """List the scenes known by name, or check one: size, free space, what of it can be seen."""

    spec: Annotated[str | None, tyro.conf.Positional, option("[SCENE]", "")] = None
    """A name with options (apartment?seed=3&rooms=4), a mesh file (house.glb?units=cm&up=auto) or a folder."""
    picture: PathName = None
    """Write a picture of the scene to this PNG file."""
    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """List the registered scenes, or describe one and draw it if asked to."""
        console = make_console()
        console.quiet = self.json
        if self.spec is None:
            if self.picture is not None:
                raise InputError("--picture needs a scene: asg scenes SCENE --picture FILE.png")
            if self.json:
                return print_json(_registered())
            table = plain_table("Scenes known by name", "name", "options")
            for row in _registered():
                shown = (name if value is None else f"{name}={value}" for name, value in row["options"].items())
                table.add_row(escape(row["name"]), escape(", ".join(shown)))
            print_whole(console, table)
            console.print(
                "Options are written as in 'apartment?seed=3&rooms=4', in quotes, or a shell reads the ? and the &. "
                "Any glb, gltf, obj, ply, stl or dae file is a scene too, and so are folders of published datasets "
                "(guide: own_scene): asg scenes FILE checks it."
            )
            return 0
        _check_picture(self.picture)
        with console.status(f"loading {escape(self.spec)}") as status:
            facts = describe(self.spec, status.update)
        if self.json:
            notes = [text for name, text in facts["lines"] if name == "note"]
            print_json({**dict(facts["lines"]), "note": notes})
        else:
            table = plain_table("", "", "")
            for name, text in facts["lines"]:
                table.add_row(f"[bold]{name}[/]", escape(text))
            print_whole(console, table)
        if self.picture is not None:
            from activestructure_gym.evaluation.archive.parts import writing
            from activestructure_gym.evaluation.report.scene_picture import scene_picture
            from activestructure_gym.files import replaced

            with console.status("drawing"):
                picture = scene_picture(facts["truth"])
                with writing(self.picture), replaced(self.picture) as file:
                    picture.save(file, "PNG")
            console.print(f"picture: {escape(self.picture)}")
        return 0


def describe(spec: str, notify: Any = lambda _: None) -> dict[str, Any]:
    """The ``truth`` of the loaded scene, and ``lines`` of (name, text) about it."""
    from activestructure_gym.ground_truth import ground_truth_of
    from activestructure_gym.scenes import load_scene

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # they stand in the scene's notes
        scene = load_scene(spec)
    notify("finding free space")
    known = ground_truth_of(scene)
    space = known.free_space
    notify("finding what can be seen")
    seen = known.observable_surface
    extent = scene.bounds[1] - scene.bounds[0]
    lines = [
        ("scene", scene.name),
        ("source", scene.source),
        ("size", " x ".join(f"{side:.2f}" for side in extent) + " m (x, y, z)"),
        ("mesh", f"{len(scene.mesh.faces):,} triangles, {len(scene.mesh.textures)} textures"),
        ("free space", f"{space.volume:.1f} m3, {len(space.start_poses)} start poses"),
        ("can be seen", f"{seen.area:.1f} m2, {100 * seen.area_share:.0f} % of the surface"),
        ("recorded views", str(len(scene.evaluation_views)) if scene.evaluation_views is not None else "none"),
        ("content", scene.content_hash[:16]),
    ]
    lines += [("note", note) for note in scene.notes]
    bottomless = float(np.isinf(space.height[space.clearance > 0]).mean())
    if bottomless > _MOST_BOTTOMLESS:
        lines.append(("note", f"{100 * bottomless:.0f} % of the free space has no floor below; is one missing?"))
    return {"truth": known, "lines": lines}


def _registered() -> list[dict[str, Any]]:
    """Names and their options; an option without a default is None."""
    from activestructure_gym.scenes import SCENES

    rows = []
    for name in SCENES:
        parameters = inspect.signature(SCENES.get(name)).parameters.values()
        options = [p for p in parameters if p.name != "path"]
        reads_files = len(options) < len(parameters)
        takes = {p.name: None if p.default is p.empty else p.default for p in options}
        rows.append({"name": f"{name}:PATH" if reads_files else name, "options": takes})
    return rows


def _check_picture(name: str | None) -> None:
    if name is None:
        return
    if Path(name).suffix.lower() != ".png":
        raise InputError(f"--picture writes PNG files, got '{name}'; give a name that ends with .png")
    if not Path(name).resolve().parent.is_dir():
        raise InputError(f"there is no folder '{Path(name).resolve().parent}' to write the picture into")
