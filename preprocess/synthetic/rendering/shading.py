"""Shading of surface samples: textures, bump mapping, shadowed key light, fill, rim and sky, scattering skin, gloss.

Directions and positions are in room coordinates, colors are linear. Kernels are single-threaded and release the GIL.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel


class Mesh(NamedTuple):
    """Posed geometry.

    Attributes:
        points: Vertices [V, 3], m.
        normals: Unit normals [V, 3].
        occlusion: Sky visibility [V, 1], 0 to 1.
        faces: Triangles [F, 3].
        uv: Texture coordinates of every corner [F, 3, 2].
        material: Material of each face [F].
    """

    points: ndarray
    normals: ndarray
    occlusion: ndarray
    faces: ndarray
    uv: ndarray
    material: ndarray


class Textures(NamedTuple):
    """Textures and materials.

    Attributes:
        albedo: Linear colors [T, R, R, 3].
        height: Heights [T, R, R], m.
        materials: Texture, roughness, gloss, scattering and mirror of each material [M, 5].
    """

    albedo: ndarray
    height: ndarray
    materials: ndarray


class Lights(NamedTuple):
    """Lights and camera.

    Attributes:
        directions: Unit directions towards the lights [L, 3]; the first is the key light, which casts shadows.
        colors: Their linear colors [L, 3].
        sky: Linear color of light from above [3].
        ground: Linear color of light from below [3].
        camera: Position of the camera [3], m.
    """

    directions: ndarray
    colors: ndarray
    sky: ndarray
    ground: ndarray
    camera: ndarray


class Shadow(NamedTuple):
    """Shadow map of the key light.

    Attributes:
        depth: Depth along the light [S, S], m.
        room_to_map: Affine map from the room to column, row and depth [3, 4].
    """

    depth: ndarray
    room_to_map: ndarray


_SHADOW_BIAS = 0.0035
_SOFTBOX = (0.34, 0.24)


@inlined
def _bilinear(values, x, y):
    """Bilinear sample of a scalar texture, clamped at the border."""
    size = values.shape[0]
    x, y = min(max(x, 0.0), size - 1.001), min(max(y, 0.0), size - 1.001)
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    top = values[row, column] * (1 - fx) + values[row, column + 1] * fx
    bottom = values[row + 1, column] * (1 - fx) + values[row + 1, column + 1] * fx
    return top * (1 - fy) + bottom * fy


@inlined
def shadowed(shadow, x, y, z):
    """Fraction of the key light that arrives, from 0 to 1, filtered over 4 × 4 texels of the shadow map."""
    m = shadow.room_to_map
    column = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    row = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    depth = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    size = shadow.depth.shape[0]
    left, top = int(np.floor(column - 2.0)), int(np.floor(row - 2.0))
    if left < 0 or top < 0 or left + 4 >= size or top + 4 >= size:
        return 1.0
    fx, fy = column - 2.0 - left, row - 2.0 - top
    lit = 0.0
    for i in range(5):
        for j in range(5):
            weight = (fy if i == 4 else (1 - fy if i == 0 else 1.0)) * (fx if j == 4 else (1 - fx if j == 0 else 1.0))
            margin = (shadow.depth[top + i, left + j] + _SHADOW_BIAS - depth) / 0.002
            lit += weight * min(max(margin + 0.5, 0.0), 1.0)
    return lit / 16.0


@inlined
def _gloss(ndoth, ndotv, ndotl, vdoth, roughness):
    """Trowbridge–Reitz (GGX) highlight times the cosine, with Schlick's Fresnel term for skin (reflectance 0.035)."""
    a2 = roughness**4
    d = a2 / (np.pi * (ndoth * ndoth * (a2 - 1) + 1) ** 2)
    k = (roughness + 1) ** 2 / 8
    g = 1 / ((ndotl * (1 - k) + k) * (ndotv * (1 - k) + k))
    fresnel = 0.035 + 0.965 * (1 - vdoth) ** 5
    return 0.25 * d * g * fresnel * ndotl


@inlined
def _bumped(mesh, textures, face, texture, u, v, normal):
    """Normal perturbed by the height texture (surface gradient of Mikkelsen 2010); returns x, y, z."""
    a, b, c = mesh.faces[face, 0], mesh.faces[face, 1], mesh.faces[face, 2]
    du1, dv1 = mesh.uv[face, 1, 0] - mesh.uv[face, 0, 0], mesh.uv[face, 1, 1] - mesh.uv[face, 0, 1]
    du2, dv2 = mesh.uv[face, 2, 0] - mesh.uv[face, 0, 0], mesh.uv[face, 2, 1] - mesh.uv[face, 0, 1]
    area = du1 * dv2 - du2 * dv1
    nx, ny, nz = normal
    if abs(area) < 1e-9:
        return nx, ny, nz
    p = mesh.points
    e1x, e1y, e1z = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
    e2x, e2y, e2z = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1], p[c, 2] - p[a, 2]
    ux, uy, uz = (e1x * dv2 - e2x * dv1) / area, (e1y * dv2 - e2y * dv1) / area, (e1z * dv2 - e2z * dv1) / area
    vx, vy, vz = (e2x * du1 - e1x * du2) / area, (e2y * du1 - e1y * du2) / area, (e2z * du1 - e1z * du2) / area
    r1x, r1y, r1z = vy * nz - vz * ny, vz * nx - vx * nz, vx * ny - vy * nx
    r2x, r2y, r2z = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    det = ux * r1x + uy * r1y + uz * r1z
    if abs(det) < 1e-9:
        return nx, ny, nz
    height = textures.height[texture]
    size = height.shape[0]
    x, y = u * size - 0.5, v * size - 0.5
    hu = (_bilinear(height, x + 0.75, y) - _bilinear(height, x - 0.75, y)) * size / 1.5
    hv = (_bilinear(height, x, y + 0.75) - _bilinear(height, x, y - 0.75)) * size / 1.5
    gx, gy, gz = (hu * r1x + hv * r2x) / det, (hu * r1y + hv * r2y) / det, (hu * r1z + hv * r2z) / det
    nx, ny, nz = nx - gx, ny - gy, nz - gz
    length = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    return nx / length, ny / length, nz / length


@inlined
def _softbox(lights, rx, ry, rz):
    """Reflection of a rectangular softbox around the key direction on a mirror-like surface, 0 to 1."""
    dx, dy, dz = lights.directions[0, 0], lights.directions[0, 1], lights.directions[0, 2]
    along = rx * dx + ry * dy + rz * dz
    if along <= 0:
        return 0.0
    flat = np.sqrt(dx * dx + dz * dz)
    right = (rx * dz - rz * dx) / flat
    up = (ry - along * dy) / flat
    edge_x = min(max((_SOFTBOX[0] - abs(right / along)) / 0.05, 0.0), 1.0)
    edge_y = min(max((_SOFTBOX[1] - abs(up / along)) / 0.05, 0.0), 1.0)
    return edge_x * edge_y


@kernel
def shade(face, weights, mesh, textures, lights, shadow, color):
    """Fill `color` [H, W, 3] where `face` [H, W] is not −1; `weights` [H, W, 2] are barycentric."""
    out = np.zeros(4)
    for row in range(face.shape[0]):
        for column in range(face.shape[1]):
            index = face[row, column]
            if index < 0:
                continue
            _shade_sample(index, weights[row, column, 0], weights[row, column, 1], mesh, textures, lights, shadow, out)
            color[row, column, 0], color[row, column, 1], color[row, column, 2] = out[0], out[1], out[2]


@inlined
def _mixed(values, mesh, index, second, third, axis):
    """Component `axis` of a vertex attribute [V, K], interpolated with barycentric weights."""
    first = 1.0 - second - third
    a, b, c = mesh.faces[index, 0], mesh.faces[index, 1], mesh.faces[index, 2]
    return first * values[a, axis] + second * values[b, axis] + third * values[c, axis]


@inlined
def _shade_sample(index, second, third, mesh, textures, lights, shadow, out):
    """Write the color of one sample to `out`."""
    px, py, pz = (
        _mixed(mesh.points, mesh, index, second, third, 0),
        _mixed(mesh.points, mesh, index, second, third, 1),
        _mixed(mesh.points, mesh, index, second, third, 2),
    )
    vx, vy, vz = lights.camera[0] - px, lights.camera[1] - py, lights.camera[2] - pz
    length = np.sqrt(vx * vx + vy * vy + vz * vz)
    vx, vy, vz = vx / length, vy / length, vz / length
    nx, ny, nz = (
        _mixed(mesh.normals, mesh, index, second, third, 0),
        _mixed(mesh.normals, mesh, index, second, third, 1),
        _mixed(mesh.normals, mesh, index, second, third, 2),
    )
    length = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    nx, ny, nz = nx / length, ny / length, nz / length
    first = 1.0 - second - third
    u = first * mesh.uv[index, 0, 0] + second * mesh.uv[index, 1, 0] + third * mesh.uv[index, 2, 0]
    v = first * mesh.uv[index, 0, 1] + second * mesh.uv[index, 1, 1] + third * mesh.uv[index, 2, 1]
    material = textures.materials[mesh.material[index]]
    texture = int(material[0])
    mirror = material[4]
    if mirror < 0.5:
        nx, ny, nz = _bumped(mesh, textures, index, texture, u, v, (nx, ny, nz))
    facing = nx * vx + ny * vy + nz * vz
    if facing < 0:
        nx, ny, nz, facing = nx - 1.02 * facing * vx, ny - 1.02 * facing * vy, nz - 1.02 * facing * vz, 0.02
    occlusion = _mixed(mesh.occlusion, mesh, index, second, third, 0)
    lit = shadowed(shadow, px + 0.002 * nx, py + 0.002 * ny, pz + 0.002 * nz)
    # Teeth and tongue scatter so much light that shadows between them stay soft.
    lit += (1 - lit) * max(material[3] - 1.0, 0.0) * 0.6
    _collect(material, lights, (nx, ny, nz), (vx, vy, vz), lit, occlusion, out)
    highlight = out[3]
    size = textures.albedo.shape[1]
    x, y = u * size - 0.5, v * size - 0.5
    for channel in range(3):
        out[channel] = (
            out[channel] * _bilinear(textures.albedo[texture, :, :, channel], x, y)
            + highlight * lights.colors[0, channel] * 0.5
        )
    if mirror > 0:
        twice = 2 * facing
        shine = _softbox(lights, twice * nx - vx, twice * ny - vy, twice * nz - vz) * (0.3 + 0.7 * lit)
        fresnel = 0.03 + 0.97 * (1 - facing) ** 5
        for channel in range(3):
            out[channel] += (
                mirror
                * lights.colors[0, channel]
                * (2.2 * shine * (0.2 + fresnel) + 0.25 * fresnel * lights.sky[channel])
                * occlusion
            )


@inlined
def _collect(material, lights, normal, view, lit, occlusion, out):
    """Write the incoming diffuse light per channel to `out[0:3]` and the highlight to `out[3]`."""
    nx, ny, nz = normal
    vx, vy, vz = view
    roughness, gloss, scatter = material[1], material[2], material[3]
    facing = max(nx * vx + ny * vy + nz * vz, 0.02)
    up = 0.5 + 0.5 * ny
    # Light scattered through the skin makes creases redder.
    for channel in range(3):
        leak = occlusion ** (1.0 - scatter * (0.55, 0.15, 0.05)[channel])
        out[channel] = (lights.ground[channel] * (1 - up) + lights.sky[channel] * up) * leak
    out[3] = 0.0
    for light in range(lights.directions.shape[0]):
        lx, ly, lz = lights.directions[light, 0], lights.directions[light, 1], lights.directions[light, 2]
        cosine = nx * lx + ny * ly + nz * lz
        reach = lit if light == 0 else occlusion
        for channel in range(3):
            wrap = scatter * (0.42, 0.16, 0.10)[channel]
            softened = reach ** (1.0 - 0.8 * wrap)
            out[channel] += (
                lights.colors[light, channel]
                * max((cosine + wrap) / (1 + wrap), 0.0)
                * softened
                * (0.35 + 0.65 * occlusion)
            )
        if cosine > 0.01:
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            length = np.sqrt(hx * hx + hy * hy + hz * hz) + 1e-9
            ndoth, vdoth = (nx * hx + ny * hy + nz * hz) / length, (vx * hx + vy * hy + vz * hz) / length
            strength = lights.colors[light, 1] / lights.colors[0, 1]
            out[3] += gloss * reach * occlusion * strength * _gloss(ndoth, facing, cosine, vdoth, roughness)
