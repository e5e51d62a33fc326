"""Generate apartments and rooms from a seed: closed surfaces, furniture, textures, baked light, part labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.procedural.apartment_plan import ApartmentPlan, plan_apartment
from activestructure_gym.scenes.procedural.baked_light import WindowLight, bake_light
from activestructure_gym.scenes.procedural.furniture import Light, draw_piece
from activestructure_gym.scenes.procedural.layout import MAX_ROOMS, UNIT, Layout, Space
from activestructure_gym.scenes.procedural.materials import Materials
from activestructure_gym.scenes.procedural.mesh_builder import BuiltMesh, Material, MeshBuilder
from activestructure_gym.scenes.procedural.room_shell import add_shell
from activestructure_gym.scenes.procedural.room_trim import add_trim
from activestructure_gym.scenes.raycaster import RayCaster
from activestructure_gym.scenes.scene import PartLabels, Scene, SceneMesh

_BOX_TRIANGLES = 1900  # maximum number of triangles of the walls of the box room, which has fewer than 2000 in all


def make_apartment(*, seed: int = 0, rooms: int = 3, furnished: bool = True, lit: bool = True) -> Scene:
    """Return a furnished apartment with exactly ``rooms`` rooms (1 to 7), deterministic in its arguments.

    The first room is a living room. With ``rooms=1`` the seed selects living room, bedroom, study or kitchen in turn.
    The floor is z = 0, the ceiling 2.7 m, and the plan is in x, y >= 0. ``lit=False`` skips light and textures, which
    take most of the time: the same triangles in flat colours. Raises `InputError` for invalid arguments.
    """
    _check_seed(seed)
    if isinstance(rooms, bool) or not isinstance(rooms, int | np.integer) or not 1 <= rooms <= MAX_ROOMS:
        raise InputError(
            f"an apartment has 1 to {MAX_ROOMS} rooms, got rooms={rooms!r}; give a whole number in that range"
        )
    plan = plan_apartment(seed=int(seed), rooms=int(rooms), furnished=furnished)
    options = f"seed={int(seed)}, rooms={int(rooms)}, furnished={bool(furnished)}" + ("" if lit else ", lit=False")
    name = f"apartment-{int(rooms)}-{int(seed)}" + ("" if furnished else "-empty") + ("" if lit else "-unlit")
    return build_apartment(plan, name=name, source=f"make_apartment({options})", seed=int(seed), lit=lit)


def build_apartment(plan: ApartmentPlan, *, name: str, source: str, seed: int, lit: bool = True) -> Scene:
    """Return the scene of an apartment's plan, with materials drawn from the seed; ``lit=False`` skips light."""
    layout = plan.layout
    materials = Materials(seed, painted=lit)
    builder = MeshBuilder()
    lines = [np.arange(size + 1) * UNIT for size in layout.owner.shape]
    add_shell(builder, layout.owner, lines, lambda *side: _describe_side(layout, materials, *side))
    add_trim(builder, materials, layout)
    for piece in plan.pieces:
        draw_piece(builder, materials, piece)
    windows = [_window_light(layout, space) for space in layout.spaces if space.kind == "window"]
    built = builder.build()
    if not lit:
        return _scene(name, source, built, materials, built.tint)
    return _finish(name, source, built, materials, plan.lights, windows)


def make_box_room(*, seed: int = 0, size: Sequence[float] = (4.0, 3.0, 2.5)) -> Scene:
    """Return an empty box-shaped room of width x depth x height metres with one corner at the origin.

    It has fewer than 2000 triangles. Raises `InputError` for sizes outside 0.5 to 50 m.
    """
    _check_seed(seed)
    try:
        extent = np.asarray(size, dtype=float)
    except (TypeError, ValueError):
        extent = np.zeros(0)
    if extent.shape != (3,) or not np.isfinite(extent).all() or extent.min() < 0.5 or extent.max() > 50:
        raise InputError(f"a box room needs three sizes between 0.5 and 50 m (width, depth, height), got {size!r}")
    # Cell size in metres. Each cell has two triangles; the first size follows from the area of the box, and grows until
    # the number of triangles is below the limit.
    pairs = extent[[1, 2, 0]] * extent[[2, 0, 1]]
    pitch = float(np.sqrt(4 * pairs.sum() / _BOX_TRIANGLES))
    while True:
        cells = np.ceil(extent / pitch).astype(int)
        if 4 * (cells[[1, 2, 0]] * cells[[2, 0, 1]]).sum() <= _BOX_TRIANGLES:
            break
        pitch *= 1.05
    materials = Materials(int(seed), detail=0.5)  # half the texture size, since textures take most of the time
    builder = MeshBuilder()
    sides = {(2, -1): "floor living", (2, 1): "ceiling", (0, -1): "wall paper", (1, 1): "wall accent"}

    def describe(owner: int, axis: int, sign: int) -> tuple[str, Material, bool]:
        role = sides.get((axis, sign), "wall 1")
        return _side_name("box", axis, sign), materials[role], False

    add_shell(
        builder, np.zeros(cells, dtype=np.int16), [np.linspace(0, e, c + 1) for e, c in zip(extent, cells)], describe
    )
    lamp = Light((0.45 * extent[0], 0.55 * extent[1], 0.75 * extent[2]), 0.1, (2.0, 1.9, 1.75), upward=0.15)
    text = ", ".join(f"{value:g}" for value in extent)
    source = f"make_box_room(seed={int(seed)}, size=({text}))"
    return _finish(f"box-{int(seed)}", source, builder.build(), materials, [lamp], [])


def _check_seed(seed: int) -> None:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"a scene's seed is a whole number from 0 up, got seed={seed!r}")


def _side_name(owner: str, axis: int, sign: int) -> str:
    if axis == 2:
        return f"{owner} {'ceiling' if sign > 0 else 'floor'}"
    return f"{owner} wall {'-+'[sign > 0]}{'xy'[axis]}"


def _describe_side(
    layout: Layout, materials: Materials, owner: int, axis: int, sign: int
) -> tuple[str, Material, bool]:
    """Return part name, material, and whether the texture covers the side once, for one flat side of a space.

    A space is a room, a doorway or a window niche with the index ``owner``. The side is at the low (-1) or high (1) end
    (``sign``) of ``axis``.
    """
    space = layout.spaces[owner]
    if owner < layout.rooms:
        name = _side_name(f"{space.kind} {owner}", axis, sign)
        if axis == 2:
            return name, materials["ceiling" if sign > 0 else f"floor {space.kind}"], False
        return name, materials[_wall_role(space, axis, sign)], False
    name = f"{space.kind} {owner}"
    outward = axis < 2 and space.outward[axis] == sign
    if space.kind == "window" and outward:
        return f"{name} pane", materials[f"street {owner % 3}"], True  # all windows share three views
    if axis == 2 and sign < 0 and space.kind == "door":
        return f"{name} floor", materials[f"floor {layout.spaces[space.room].kind}"], False
    return f"{name} jamb", materials["trim"], False


def _wall_role(space: Space, axis: int, sign: int) -> str:
    if space.kind == "bath":
        return "wall bath"
    # In living and sleeping rooms, the long wall farther from the origin has another colour.
    extent = np.array(space.upper) - space.lower
    accent = int(extent[0] <= extent[1]) != axis and sign > 0
    if space.kind in ("living", "bedroom", "child") and accent:
        return "wall paper" if space.kind == "bedroom" else "wall accent"
    return f"wall {space.room % 3}"


def _window_light(layout: Layout, space: Space) -> WindowLight:
    outward = np.array([*space.outward, 0], dtype=float)
    lower, upper = space.box
    axis = int(np.argmax(np.abs(outward)))
    lower, upper = lower.copy(), upper.copy()
    if outward[axis] > 0:
        lower[axis] = upper[axis]
    else:
        upper[axis] = lower[axis]
    return WindowLight(lower, upper, -outward, layout.spaces[space.room].box)


def _finish(
    name: str,
    source: str,
    built: BuiltMesh,
    materials: Materials,
    lights: Sequence[Light],
    windows: Sequence[WindowLight],
) -> Scene:
    """Return the scene of a built mesh, with the light of ``lights`` and ``windows`` baked into its vertex colours."""
    caster = RayCaster(built.vertices, built.faces)
    # Linear mean colour of each texture, white for faces without one.
    mean = np.array([*([t[..., k].mean() / 255 for k in range(3)] for t in materials.textures), [1.0, 1.0, 1.0]])
    albedo = (mean[built.face_texture] * built.tint[built.faces[:, 0]]) ** 2.2
    albedo[built.glow[built.faces[:, 0]] > 0] = 0.0  # lamps and panes are light sources and reflect nothing
    light = bake_light(built, caster, face_albedo=albedo.astype(np.float32), lights=lights, windows=windows)
    scene = _scene(name, source, built, materials, (built.tint * light).astype(np.float32))
    scene.__dict__["raycaster"] = caster  # already built for the light; avoids a second build
    return scene


def _scene(name: str, source: str, built: BuiltMesh, materials: Materials, colors: np.ndarray) -> Scene:
    mesh = SceneMesh(
        vertices=built.vertices,
        faces=built.faces,
        colors=colors,
        uv=built.uv,
        face_texture=built.face_texture,
        textures=tuple(materials.textures),
    )
    labels = PartLabels(built.face_part, built.part_names, built.part_structural)
    return Scene(name=name, mesh=mesh, source=source, labels=labels, generated=True)
