"""Read the opacity of a COLLADA effect: <transparent> and <transparency>.

Specification: [collada], "Determining Transparency". In the modes A_ONE (the default) and RGB_ONE, the opacity is the
product of both. In A_ZERO and RGB_ZERO, it is 1 minus this product. A modes use the alpha of a colour, RGB modes its
luminance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.loaders.collada_numbers import floats
from activestructure_gym.scenes.loaders.collada_textures import ColladaTexture, texture_of

Element = ElementTree.Element
_LUMINANCE = (0.212671, 0.715160, 0.072169)  # weights of red, green and blue, from the specification


@dataclass(frozen=True)
class ColladaOpacity:
    """Hold the opacity of an effect: ``start + slope * x``, where x is the value of an image, or 1 without one."""

    start: float = 0.0
    slope: float = 1.0
    channel: str = "alpha"  # channel of the image that is x, "alpha" or "luminance"
    lies: ColladaTexture | None = None  # the image with its placement, None without one

    @property
    def plain(self) -> float:
        """Return the opacity of an effect without an image."""
        return self.start + self.slope

    def of(self, picture: np.ndarray) -> np.ndarray:  # [h, w] uint8 -> [h, w] uint8
        """Return the opacity of each pixel of an image, 0..255."""
        values = 255.0 * self.start + self.slope * picture.astype(np.float32)
        return np.rint(np.clip(values, 0.0, 255.0)).astype(np.uint8)


def opacity_of(shader: Element, parameters: Mapping[str, Element]) -> ColladaOpacity | None:
    """Return the opacity of a shader; None if it is undefined. ``parameters`` are the effect's parameters by name."""
    transparent, transparency = shader.find("transparent"), shader.find("transparency")
    if transparent is None and transparency is None:
        return None
    factor = _number(transparency, parameters)
    mode = "A_ONE"
    color, texture = np.ones(4), None
    if transparent is not None:
        mode = transparent.get("opaque", mode).strip().upper()
        texture = transparent.find("texture")
        given = floats(_text(transparent, "color", parameters))
        color = np.concatenate([given, color[len(given) :]])[:4] if len(given) >= 3 else color
    by_color, inverted = mode.startswith("RGB"), mode.endswith("ZERO")
    value = 1.0 if texture is not None else float(color[:3] @ _LUMINANCE if by_color else color[3])
    slope = factor * value
    return ColladaOpacity(
        start=1.0 if inverted else 0.0,
        slope=-slope if inverted else slope,
        channel="luminance" if by_color else "alpha",
        lies=texture_of(texture, parameters) if texture is not None else None,
    )


def _number(element: Element | None, parameters: Mapping[str, Element]) -> float:
    given = floats(_text(element, "float", parameters)) if element is not None else np.ones(1)
    return float(given[0]) if len(given) and np.isfinite(given[0]) else 1.0


def _text(element: Element, kind: str, parameters: Mapping[str, Element]) -> str | None:
    """Return the text with the numbers of an element, or of the parameter that it refers to; None if there is none.

    ``kind`` is "color" or "float".
    """
    reference = element.find("param")
    if reference is None:
        return element.findtext(kind)
    parameter = parameters.get(reference.get("ref", ""))
    kinds = ("float4", "float3", "color") if kind == "color" else (kind,)
    found = (parameter.findtext(name) for name in kinds) if parameter is not None else ()
    return next((text for text in found if text), None)
