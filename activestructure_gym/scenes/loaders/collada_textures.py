"""Read a COLLADA texture: its image, the set of coordinates it uses, and its placement.

The image is referenced through parameters: sampler, surface and image in 1.4, sampler and image in 1.5, or directly in
nonconforming files. The placement is in the <extra> of a <texture>, under names of Maya's node place2dTexture, which
the exporters of 3ds Max and XSI use too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

Element = ElementTree.Element

# BORDER and NONE show a colour outside the image; clamping to its edge is the closest mode.
_WRAPS = {"WRAP": REPEAT, "MIRROR": MIRROR, "MIRROR_ONCE": MIRROR, "CLAMP": CLAMP, "BORDER": CLAMP, "NONE": CLAMP}
_AS_NEAR_AS_POSSIBLE = ("MIRROR_ONCE", "BORDER", "NONE")
_NEUTRAL = {
    "rotateFrame": 0.0,
    **{f"{name}{axis}": float(name in ("coverage", "repeat")) for axis in "UV"
       for name in ("translateFrame", "coverage", "repeat", "offset", "noise")},
    "rotateUV": 0.0,
}  # fmt: skip
_TRUE, _FALSE = ("true", "1"), ("false", "0")


@dataclass(frozen=True)
class ColladaTexture:
    """Hold a texture of a COLLADA effect: its image and the placement of the image."""

    image: str  # id of its image, or the name in the last parameter
    texcoord: str = ""  # name of its coordinate set in <bind_vertex_input>
    wrap: tuple[int, int] = (REPEAT, REPEAT)  # across and down
    place: tuple[tuple[str, float], ...] = ()  # entries that differ from `_NEUTRAL`
    ignored: tuple[str, ...] = ()  # unsupported settings that change the appearance
    bounded: tuple[str, ...] = ()  # unsupported settings that change the appearance if coordinates leave the image

    def placed(self, uv: np.ndarray) -> np.ndarray:  # [V, 2] -> [V, 2], v up
        """Return the image coordinates of the mesh's coordinates ``uv``.

        As in Maya, the transform of the texture's frame comes first, then the transform of the image in the frame.
        """
        if not self.place:
            return uv
        value = {**_NEUTRAL, **dict(self.place)}

        def pair(name: str) -> list[float]:
            return [value[f"{name}U"], value[f"{name}V"]]

        uv = _turned(uv, value["rotateFrame"]) - pair("translateFrame")
        uv = uv / pair("coverage") * pair("repeat") + pair("offset")
        return _turned(uv, value["rotateUV"])


def texture_of(texture: Element, parameters: Mapping[str, Element]) -> ColladaTexture:
    """Return the content of a <texture> element; ``parameters`` are the <newparam> and <setparam> elements by name."""
    name, wraps, extras = texture.get("texture", ""), ["WRAP", "WRAP"], []
    for _ in range(3):
        parameter = parameters.get(name)
        if parameter is None:
            break
        for axis, tag in enumerate(("wrap_s", "wrap_t")):
            wraps[axis] = (parameter.findtext(f".//{tag}") or wraps[axis]).strip().upper()
        extras += parameter.findall(".//extra/technique/*")
        instance = parameter.find(".//instance_image")
        source = parameter.findtext(".//source") or parameter.findtext(".//init_from")
        name = (instance.get("url", "") if instance is not None else source or "").strip().removeprefix("#")
    said = {element.tag: (element.text or "").strip() for element in [*extras, *texture.findall("extra/technique/*")]}
    place, ignored = _place(said)
    across, down = (_wrap(wrap, axis, said, dict(place)) for axis, wrap in zip("UV", wraps))
    ignored += [f"wrap {wrap}" for wrap in dict.fromkeys(wraps) if wrap not in _WRAPS]
    return ColladaTexture(
        image=name,
        texcoord=texture.get("texcoord", ""),
        wrap=(across, down),
        place=place,
        ignored=tuple(ignored),
        bounded=tuple(f"wrap {wrap}" for wrap in dict.fromkeys(wraps) if wrap in _AS_NEAR_AS_POSSIBLE),
    )


def _place(said: Mapping[str, str]) -> tuple[tuple[tuple[str, float], ...], list[str]]:
    """Return the settings (name, number) that transform the texture, and the unsupported settings as texts.

    ``said`` are the texts in <extra> by name.
    """
    place, ignored = {}, []
    for name, neutral in _NEUTRAL.items():
        if name not in said:
            continue
        try:
            value = float(said[name])
        except ValueError:
            value = np.nan
        # An image that covers part of its frame would leave the rest to a plain colour.
        odd = not np.isfinite(value) or name.startswith("noise") or name.startswith("coverage") and 0 <= value < 1
        if odd and value != neutral:
            ignored.append(f"{name} {said[name][:20]}")
        elif value != neutral:
            place[name] = value
    if said.get("stagger", "").lower() in _TRUE:
        ignored.append("stagger")
    return tuple(place.items()), ignored


def _wrap(wrap: str, axis: str, said: Mapping[str, str], place: Mapping[str, float]) -> int:
    """Return the wrap mode along ``axis`` ("U" or "V"), from the sampler's mode ``wrap`` and Maya's settings ``said``.

    ``place`` are the settings that transform the texture.
    """
    if said.get(f"mirror{axis}", "").lower() in _TRUE:
        return MIRROR
    once = abs(place.get(f"repeat{axis}", 1.0)) <= 1.0  # a frame shown once still contains all repeats
    if said.get(f"wrap{axis}", "").lower() in _FALSE and once:
        return CLAMP
    return _WRAPS.get(wrap, REPEAT)


def _turned(uv: np.ndarray, degrees: float) -> np.ndarray:
    """Rotate coordinates [V, 2] counter-clockwise around the centre of the image."""
    if not degrees:
        return uv
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return (uv - 0.5) @ np.array([[cosine, sine], [-sine, cosine]]) + 0.5


def leaves_picture(uv: np.ndarray) -> bool:
    """Return whether any coordinates [V, 2] are outside the image by more than rounding."""
    return bool((np.abs(uv - 0.5) > 0.5 + 1e-4).any())


def chosen_set(sets: Mapping[int, object], texcoord: str, bound: Mapping[str, int]) -> tuple[int, bool]:
    """Return the coordinate set that a texture uses, and whether it is certain.

    ``texcoord`` is the name of the set in the texture. ``bound`` maps names to numbers of sets, from
    <bind_vertex_input>; without an entry, the number at the end of the name is used.
    """
    digits = texcoord[len(texcoord.rstrip("0123456789")) :]
    wanted = bound.get(texcoord, int(digits[:9]) if digits else -1)
    if wanted in sets:
        return wanted, True
    return min(sets), len(sets) == 1 or not texcoord
