"""Define ``asg list scenes``, which lists the registered scenes, or checks a scene and its regions of free space."""

from __future__ import annotations

import inspect
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from rich.table import Table

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.cli.fields import PathName, Switch, option
from activestructure_gym.evaluation.cli.listing import print_json
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.streams import escape

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.ground_truth.regions import Region

_MAX_LISTED = 8  # largest number of regions in the table
_SAMPLES = 10_000  # sample points for the observable share of the surface from a region that is not used
_MAX_BOTTOMLESS = 0.1  # share of the free space that may lack a floor without a note; every scan has small holes


@dataclass(frozen=True)
class Scenes:
    """List the scenes, or check one.

    A check prints the size, the regions of free space, and the surface that can be observed.
    """

    spec: Annotated[str | None, tyro.conf.Positional, option("[SCENE]", "")] = None
    """Check this scene: a name with options (apartment?seed=3), a mesh file (house.glb?units=cm) or a folder."""
    picture: PathName = None
    """Write a picture of the scene to this PNG file."""
    json: Switch = False
    """Print JSON."""

    def run(self) -> int:
        """Print the registered scenes, or describe one scene and with ``--picture`` draw it."""
        console = make_console()
        console.quiet = self.json
        if self.spec is None:
            if self.picture is not None:
                raise InputError("--picture needs a scene: asg list scenes SCENE --picture FILE.png")
            if self.json:
                return print_json(_registered())
            table = plain_table("Scenes known by name", "name", "options")
            for row in _registered():
                shown = (name if value is None else f"{name}={value}" for name, value in row["options"].items())
                table.add_row(escape(row["name"]), escape(", ".join(shown)))
            print_whole(console, table)
            console.print(
                "Options are written as in 'apartment?seed=3&rooms=4', in quotes, or a shell reads the ? and the &. "
                "Every scene also takes inside=x,y,z, a point of the region of free space that is used. "
                "Any glb, gltf, obj, ply, stl or dae file is a scene too, and so are folders of published datasets "
                "(guide: own_scene): asg list scenes FILE checks it."
            )
            return 0
        _check_picture(self.picture)
        with console.status(f"loading {escape(self.spec)}") as status:
            facts = describe(self.spec, status.update)
        if self.json:
            notes = [text for name, text in facts["lines"] if name == "note"]
            print_json({**dict(facts["lines"]), "note": notes, "regions": facts["regions"]})
        else:
            table = plain_table("", "", "")
            for name, text in facts["lines"]:
                table.add_row(f"[bold]{name}[/]", escape(text))
            print_whole(console, table)
            print_whole(console, _region_table(facts["regions"]))
        if self.picture is not None:
            from activestructure_gym.evaluation.archive.temporary import writing
            from activestructure_gym.evaluation.report.pictures.scene_figure import scene_picture
            from activestructure_gym.files import replaced

            with console.status("drawing"):
                picture = scene_picture(facts["truth"])
                with writing(self.picture), replaced(self.picture) as file:
                    picture.save(file, "PNG")
            console.print(f"picture: {escape(self.picture)}")
        return 0


def describe(spec: str, notify: Any = lambda _: None) -> dict[str, Any]:
    """Load the scene ``spec`` and return its description as a dictionary.

    ``truth`` is its ground truth, ``lines`` are (name, text) pairs that describe it, and ``regions`` has one dictionary
    per region of free space. ``notify`` is called with a text at the beginning of each slow part.
    """
    from activestructure_gym.ground_truth import ground_truth_of
    from activestructure_gym.ground_truth.truth import hardly_seen
    from activestructure_gym.scenes import load_scene

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # the same texts are in the scene's notes, which are printed
        scene = load_scene(spec)
    notify("finding free space")
    known = ground_truth_of(scene)
    regions = known.regions
    space = known.free_space
    notify("computing the observable surface")
    seen = known.observable_surface
    extent = scene.bounds[1] - scene.bounds[0]
    lines = [
        ("scene", scene.name),
        ("source", scene.source),
        ("size", " x ".join(f"{side:.2f}" for side in extent) + " m (x, y, z)"),
        ("mesh", f"{len(scene.mesh.faces):,} triangles, {len(scene.mesh.textures)} textures"),
        ("free space", f"{space.volume:.1f} m³, {len(space.start_poses)} start poses"),
        ("can be seen", f"{seen.area:.1f} m², {100 * seen.area_share:.0f} % of the surface"),
        ("recorded views", str(len(scene.evaluation_views)) if scene.evaluation_views is not None else "none"),
        ("content", scene.content_hash[:16]),
    ]
    ground = regions.ground(regions.used)
    notes = list(scene.notes)
    if ground.level_area and ground.ceiling_height is None:
        lid = f"the top of the scene's bounds, z {scene.bounds[1, 2]:.2f} m, closes its free space"
        notes = [note for note in notes if ", ceiling height " not in note and "no ceiling found" not in note]
        notes.insert(0, f"no ceiling found over {100 * (1 - ground.covered_share):.0f} % of the level ground: {lid}")
    bottomless = float(np.isinf(space.height[space.clearance > 0]).mean())
    if bottomless > _MAX_BOTTOMLESS:
        notes.append(f"{100 * bottomless:.0f} % of the free space has no floor below; is one missing?")
    notes += [text for text in (hardly_seen(known),) if text]
    lines += [("note", note) for note in notes]
    return {"truth": known, "lines": lines, "regions": [_region(known, region, notify) for region in _listed(known)]}


def _listed(known: GroundTruth) -> list[Region]:
    """Return the `_MAX_LISTED` regions with the most level ground, and the region in use."""
    places, used = known.regions.places, known.regions.used
    return [region for number, region in enumerate(places) if number < _MAX_LISTED or region is used]


def _region(known: GroundTruth, region: Region, notify: Any) -> dict[str, Any]:
    from activestructure_gym.ground_truth.free_space import free_space_in
    from activestructure_gym.ground_truth.observable import observable_surface_of
    from activestructure_gym.ground_truth.regions import in_text

    regions = known.regions
    number, ground, point = regions.number(region), regions.ground(region), regions.name_of(region)
    short = np.round(point, 1)
    name = in_text(short if regions.at(short) is region else point)
    if region is regions.used:
        share = known.observable_surface.area_share
    else:
        notify(f"computing the surface observable from region {number} of {len(regions.places)}")
        x, y, z = (float(value) for value in name.split(","))
        other = replace(known.scene, inside=(x, y, z))
        share = observable_surface_of(other, free_space_in(region), _SAMPLES).area_share
    return {
        "number": number,
        "used": region is regions.used,
        "volume_m3": round(region.volume, 1),
        "floor_z_m": None if ground.floor is None else round(ground.floor, 2),
        "ceiling_m": None if ground.ceiling_height is None else round(ground.ceiling_height, 2),
        "level_ground_m2": round(ground.level_area, 1),
        "seen_share": round(share, 3),
        "inside": name,
    }


def _region_table(rows: list[dict[str, Any]]) -> Table:
    """Return a table of the regions, given as dictionaries of `_region`, that fits a terminal of 80 characters."""
    table = plain_table("Regions of free space (* is used; the scene's option inside=X,Y,Z uses another)")
    for column in ("", "volume m³", "floor z m", "ceiling m", "level m²", "seen", "inside="):
        table.add_column(column, justify="left" if column == "inside=" else "right", no_wrap=True)
    for row in rows:
        floor, ceiling = row["floor_z_m"], row["ceiling_m"]
        table.add_row(
            f"{'* ' if row['used'] else ''}{row['number']}",
            f"{row['volume_m3']:.1f}",
            "none" if floor is None else f"{floor:.2f}",
            "none" if ceiling is None else f"{ceiling:.2f}",
            f"{row['level_ground_m2']:.1f}",
            f"{100 * row['seen_share']:.0f} %",
            row["inside"],
        )
    return table


def _registered() -> list[dict[str, Any]]:
    """Return one dictionary per registered scene: its name, and its options with their defaults.

    The value of an option without a default is None.
    """
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
