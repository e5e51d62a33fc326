"""OBJ and COLLADA files that ask for much: lines, materials, nodes, entities."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz._bomb_sizes import HUGE, fan_out, pick
from tests.fuzz._bombs_pictures import plain_png
from tests.fuzz._rooms import MTL, QUADS, dae_text, encoded, obj_text


def make_obj_lines(rng: np.random.Generator, folder: Path) -> Path:
    count = int(pick(rng, (1000, 20_000, 100_000)))
    kind = rng.integers(13)
    faces = {
        0: "".join(f"usemtl m{k}\nf 1 2 3\n" for k in range(count)),
        1: "".join(f"g g{k}\nf 1 2 3\n" for k in range(count)),
        2: "".join(f"o o{k}\nusemtl red\nf 1 2 3\n" for k in range(count)),
        3: "f " + " ".join(str(1 + k % 8) for k in range(count)) + "\n",
        4: "f 1 2 4 3 1 5\n" * count,
        5: "v 0 0 0\nf -1 -2 -3\n" * count,
        6: "\n" * (10 * count),
        7: f"v {'9' * 10 * count} 0 0\n",
        8: f"f 1 2 {pick(rng, HUGE)}\n",
        9: f"f 1 2 {-pick(rng, HUGE)}\n",
        10: "\\\n" * count,
        11: "v " + "1 " * count + "\n",
        12: "".join(f"usemtl m{k}\nv 0 0 {k}\nv 1 0 0\nv 0 1 0\nf -1 -2 -3\n" for k in range(count)),
    }[int(kind)]
    (folder / "room.obj").write_text(obj_text(faces))
    (folder / "room.mtl").write_text(MTL + "".join(f"newmtl m{k}\nKd 0 0 {k % 10 / 10}\n" for k in range(count)))
    (folder / "paper.png").write_bytes(encoded("PNG"))
    return folder / "room.obj"


def make_materials(rng: np.random.Generator, folder: Path) -> Path:
    """Every material of many has the same large texture."""
    count = int(pick(rng, (100, 20_000)))
    names = "".join(f"newmtl m{k}\nmap_Kd paper.png\n" for k in range(count))
    (folder / "room.mtl").write_text(MTL + names)
    (folder / "room.obj").write_text(obj_text("".join(f"usemtl m{k}\nf 1/1 2/2 3/3\n" for k in range(count))))
    (folder / "paper.png").write_bytes(plain_png(4096, 4096))
    return folder / "room.obj"


def make_polygons(rng: np.random.Generator, folder: Path) -> Path:
    """One polygon that is as hard to cut as can be."""
    count = int(pick(rng, (1000, 20_000, 100_000)))
    angle = np.linspace(0, 40 * np.pi * rng.random(), count)
    radius = 1 + (rng.random(count) if rng.random() < 0.5 else np.arange(count) % 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)], axis=1)
    rows = "\n".join(f"v {x:.6f} {y:.6f} {z:.0f}" for x, y, z in points)
    (folder / "room.obj").write_text(obj_text(f"{rows}\nf {' '.join(str(9 + k) for k in range(count))}\n"))
    return folder / "room.obj"


def make_dae_nodes(rng: np.random.Generator, folder: Path) -> Path:
    levels, copies = fan_out(rng)
    loop = rng.random() < 0.3
    library = "".join(
        f'<node id="n{k}">' + f'<instance_node url="#n{0 if loop else k + 1}"/>' * copies + "</node>"
        for k in range(levels)
    )
    library += f'<node id="n{levels}"><instance_geometry url="#walls"/></node>'
    (folder / "a.dae").write_text(dae_text(library=library, nodes='<node><instance_node url="#n0"/></node>'))
    return folder / "a.dae"


def make_dae_instances(rng: np.random.Generator, folder: Path) -> Path:
    count = int(pick(rng, (1000, 100_000)))
    long = "<translate>0 0 0</translate>" * int(pick(rng, (1, 3000)))
    library = f'<node id="x">{long}<instance_geometry url="#walls"/></node>'
    nodes = '<instance_node url="#x"/>' * count + '<instance_geometry url="#walls"/>' * (count // 2)
    (folder / "a.dae").write_text(dae_text(library=library, nodes=f"<node>{nodes}</node>"))
    return folder / "a.dae"


def make_dae_counts(rng: np.random.Generator, folder: Path) -> Path:
    huge = str(pick(rng, (*HUGE, -1, 0, "NaN", "1e9", "")))
    text = dae_text()
    old, new = pick(
        rng,
        (
            ("<vcount>4 4", f"<vcount>{huge} 4"), ("<vcount>4 4", f"<vcount>4 {huge}"),
            ('stride="3"', f'stride="{huge}"'),
            ('offset="1"', f'offset="{huge}"'), ('count="8" stride="3"', f'count="{huge}" stride="3" offset="{huge}"'),
            ('meter="1"', f'meter="{huge}"'), ('set="0"', f'set="{huge}"'), ("<p>", f"<p>{huge} "),
            ("0 0 1 90", f"0 0 {huge} {huge}"), ("<scale>0.3", f"<scale>{huge}"), ("0 0 0<", f"{huge} {huge} {huge}<"),
        ),
    )  # fmt: skip
    (folder / "a.dae").write_text(text.replace(old, new))
    return folder / "a.dae"


def make_dae_lengths(rng: np.random.Generator, folder: Path) -> Path:
    count = int(pick(rng, (10_000, 300_000)))
    quads = " ".join(map(str, QUADS.reshape(-1)))
    more = pick(
        rng,
        (
            '<polygons><input semantic="VERTEX" source="#v" offset="0"/>' + "<p>0 1 3 2</p>" * count + "</polygons>",
            '<polygons><input semantic="VERTEX" source="#v" offset="0"/>'
            + "<ph><p>0 1 3 2</p></ph>" * (count // 100)
            + "</polygons>",
            "<polygons>" + '<input semantic="VERTEX" source="#v" offset="0"/>' * count + "<p>0 1 3 2</p></polygons>",
            f'<tristrips><input semantic="VERTEX" source="#v" offset="0"/><p>{"0 1 2 3 " * count}</p></tristrips>',
            f'<triangles><input semantic="VERTEX" source="#v" offset="0"/><p>{quads}</p></triangles>' * (count // 100),
            "<a>" * count + "</a>" * count,
            "<a/>" * (5 * count),
            "<a " + " ".join(f"b{k}='0'" for k in range(count // 10)) + "/>",
        ),
    )
    (folder / "a.dae").write_text(dae_text(more=more))
    return folder / "a.dae"


def make_entities(rng: np.random.Generator, folder: Path) -> Path:
    levels = "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(int(pick(rng, (6, 12)))))
    kind = rng.integers(4)
    doctype, use = {
        0: (f'<!ENTITY l0 "lol">{levels}', "&l6;"),
        1: (f'<!ENTITY a "{"x" * 100_000}">', "&a;" * 20_000),
        2: ('<!ENTITY a SYSTEM "file:///dev/zero">', "&a;"),
        3: ('<!ENTITY % p SYSTEM "file:///dev/zero"> %p;', ""),
    }[int(kind)]
    text = dae_text().replace("<COLLADA", f"<!DOCTYPE x [{doctype}]><COLLADA").replace("0.8 0.2 0.2", f"0.8 0.2 {use}")
    (folder / "a.dae").write_text(text)
    return folder / "a.dae"
