"""Compute the colours of pixels: texture times vertex colour, averaged over the rays of each pixel."""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT, Scene, SceneMesh


class Appearance(NamedTuple):
    """Hold colours and textures of a mesh as the arrays that the kernel `shade_pixels` reads.

    The mesh has F faces, V vertices and K textures with T texels in all.
    """

    faces: np.ndarray  # [F, 3] int32
    colors: np.ndarray  # [V, 3] float32, vertex colours; 1 is white, baked light can exceed it
    uv: np.ndarray  # [V, 2] float32, texture coordinates in widths and heights, v down
    face_texture: np.ndarray  # [F] int32, index of the texture, -1 = none
    texels: np.ndarray  # [T, 3] uint8: texels of all textures, concatenated, row by row
    texture_start: np.ndarray  # [K] int64: first texel of each texture
    texture_size: np.ndarray  # [K, 2] int64: height, width
    texture_wrap: np.ndarray  # [K, 2] int64: wrap mode of each texture across and down
    linear_colors: bool  # whether vertex colours are linear light instead of sRGB


def make_appearance(mesh: SceneMesh) -> Appearance:
    """Return the appearance of a mesh; only the texels are copied, the other arrays are the mesh's own if possible.

    Raises `ValueError` for an invalid mesh, since the kernel does not check indices.
    """
    wrong = mesh.wrong()
    if wrong:
        raise ValueError(wrong)
    textures = mesh.textures
    sizes = np.array([texture.shape[:2] for texture in textures], np.int64).reshape(-1, 2)
    counts = sizes.prod(axis=1)
    return Appearance(
        faces=np.ascontiguousarray(mesh.faces, np.int32),
        colors=np.ascontiguousarray(mesh.colors, np.float32),
        uv=np.ascontiguousarray(mesh.uv, np.float32),
        face_texture=np.ascontiguousarray(mesh.face_texture, np.int32),
        texels=np.concatenate([texture.reshape(-1, 3) for texture in textures] or [np.zeros((1, 3), np.uint8)]),
        texture_start=np.cumsum(counts) - counts,
        texture_size=sizes,
        texture_wrap=np.array(mesh.texture_wrap or [(REPEAT, REPEAT)] * len(textures), np.int64).reshape(-1, 2),
        linear_colors=bool(mesh.linear_colors),
    )


_appearances: dict[int, Appearance] = {}  # by the id of the scene object


def appearance_of(scene: Scene) -> Appearance:
    """Return the appearance of a scene, made once per scene object and shared by all its sensors."""
    key = id(scene)
    if key not in _appearances:
        _appearances[key] = make_appearance(scene.mesh)
        weakref.finalize(scene, _appearances.pop, key, None)
    return _appearances[key]


@kernel
def _wrapped_texel(coordinate, size, wrap):
    """Return the two texels nearest to a texture coordinate along one axis, and the weight of the upper one.

    ``coordinate`` is in units of the texture's size, which has ``size`` texels. ``wrap`` is the mode outside 0..1.
    Texel i is centred at i + 0.5.
    """
    if wrap == CLAMP:
        coordinate = min(coordinate, np.float32(1.0))
    elif wrap == MIRROR:
        coordinate -= np.float32(2.0) * np.floor(np.float32(0.5) * coordinate)
        coordinate = min(coordinate, np.float32(2.0) - coordinate)
    else:
        coordinate -= np.floor(coordinate)
    if not coordinate >= 0.0:  # below a clamped edge, infinite or NaN: use a texel inside the texture
        coordinate = np.float32(0.0)
    position = coordinate * np.float32(size) - np.float32(0.5)
    lower = int(np.floor(position))
    share = position - np.float32(lower)
    upper = lower + 1
    if wrap != REPEAT:  # beyond the edge, use the edge texel (clamped or mirrored)
        return min(max(lower, 0), size - 1), min(upper, size - 1), share
    if lower < 0:
        lower += size
    if upper >= size:
        upper -= size
    if lower >= size:  # a coordinate just below 1 can round up to size
        lower -= size
    return lower, upper, share


@kernel
def _displayed(linear):
    """Return the sRGB value of a linear colour value, both in 0..1 (IEC 61966-2-1)."""
    linear = min(max(linear, np.float32(0.0)), np.float32(1.0))
    if linear <= np.float32(0.0031308):
        return np.float32(12.92) * linear
    return np.float32(1.055) * linear ** np.float32(1.0 / 2.4) - np.float32(0.055)


@kernel
def shade_pixels(
    face,  # [P * stride] int32, -1 = nothing hit
    bary_u,  # [P * stride] float32, barycentric coordinate of the hit, weight of the second vertex
    bary_v,  # [P * stride] float32, weight of the third vertex
    stride,  # rays per pixel
    samples,  # number of leading rays of a pixel that carry colour
    appearance,  # `Appearance`
    rgb,  # [P, 3] uint8, written
):
    """Write the mean colour of each pixel's samples; a sample without a hit counts as black."""
    faces, colors, uv, face_texture, texels, texture_start, texture_size, texture_wrap, linear_colors = appearance
    one = np.float32(1.0)
    to_unit = np.float32(1.0 / 255.0)
    to_byte = np.float32(255.0 / samples)
    for pixel in range(len(rgb)):
        red = green = blue = np.float32(0.0)
        for ray in range(pixel * stride, pixel * stride + samples):
            triangle = face[ray]
            if triangle < 0:
                continue
            b, c = bary_u[ray], bary_v[ray]
            a = one - b - c
            i, j, k = faces[triangle, 0], faces[triangle, 1], faces[triangle, 2]
            r = a * colors[i, 0] + b * colors[j, 0] + c * colors[k, 0]
            g = a * colors[i, 1] + b * colors[j, 1] + c * colors[k, 1]
            l = a * colors[i, 2] + b * colors[j, 2] + c * colors[k, 2]
            if linear_colors:
                r, g, l = _displayed(r), _displayed(g), _displayed(l)
            texture = face_texture[triangle]
            if texture >= 0:
                height, width = texture_size[texture, 0], texture_size[texture, 1]
                across, down = texture_wrap[texture, 0], texture_wrap[texture, 1]
                x0, x1, sx = _wrapped_texel(a * uv[i, 0] + b * uv[j, 0] + c * uv[k, 0], width, across)
                y0, y1, sy = _wrapped_texel(a * uv[i, 1] + b * uv[j, 1] + c * uv[k, 1], height, down)
                top, bottom = texture_start[texture] + y0 * width, texture_start[texture] + y1 * width
                w00, w01 = (one - sy) * (one - sx) * to_unit, (one - sy) * sx * to_unit
                w10, w11 = sy * (one - sx) * to_unit, sy * sx * to_unit
                p, q, s, t = top + x0, top + x1, bottom + x0, bottom + x1
                r *= w00 * texels[p, 0] + w01 * texels[q, 0] + w10 * texels[s, 0] + w11 * texels[t, 0]
                g *= w00 * texels[p, 1] + w01 * texels[q, 1] + w10 * texels[s, 1] + w11 * texels[t, 1]
                l *= w00 * texels[p, 2] + w01 * texels[q, 2] + w10 * texels[s, 2] + w11 * texels[t, 2]
            red += min(max(r, np.float32(0.0)), one)
            green += min(max(g, np.float32(0.0)), one)
            blue += min(max(l, np.float32(0.0)), one)
        rgb[pixel, 0] = np.uint8(red * to_byte + np.float32(0.5))
        rgb[pixel, 1] = np.uint8(green * to_byte + np.float32(0.5))
        rgb[pixel, 2] = np.uint8(blue * to_byte + np.float32(0.5))
