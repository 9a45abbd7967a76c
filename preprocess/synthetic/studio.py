"""Renders frames of the generated person: surfaces, then strands, then lenses, at twice the resolution."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head
from preprocess.synthetic.animation.hair_motion import lagging_poses, swing_hair
from preprocess.synthetic.animation.performance import Performance
from preprocess.synthetic.animation.posing import PosedGeometry, pose_character, sticky_lips
from preprocess.synthetic.person.character import LENS, MOUTH, Character, build_character
from preprocess.synthetic.person.texture_space import to_linear, to_srgb
from preprocess.synthetic.person.wrinkles import add_folds
from preprocess.synthetic.rendering import room
from preprocess.synthetic.rendering.backdrop import backdrop
from preprocess.synthetic.rendering.hair_shading import strand_colors
from preprocess.synthetic.rendering.lights import room_lights, shadow_map
from preprocess.synthetic.rendering.mesh import project, rasterize, vertex_normals
from preprocess.synthetic.rendering.shading import Mesh, Shadow, Textures, shade
from preprocess.synthetic.rendering.strands import Strands, rasterize_strands

_SUPERSAMPLING = 2
_EXPOSURE = 1.0


class Studio:
    """A person, their performance, the room and its camera; `render` may be called from several threads.

    Args:
        number: Which person, 1 to 5.
        performance: What the person does.
        size: Width and height of the images, px.
        background: "plain" or "busy".
    """

    def __init__(self, number: int, performance: Performance, size: int, background: str) -> None:
        self._character = build_character(number)
        self._performance, self._size = performance, size
        self._lips = sticky_lips(self._character.head, procedural_head().template.numpy().astype(np.float64))
        self._lights = room_lights()
        self._background = backdrop(background, size, self._character.person.wall, number)
        hair = self._character.person.hair
        self._lags = lagging_poses(performance.head_to_room, 0.65 if hair.length > 0.1 else 0.0)
        self._faces, self._uv, self._material = _joined(self._character)
        self._hair_color = to_linear(np.asarray(hair.color))[None] * self._character.scalp_hair.tone[:, None].astype(
            np.float32
        )

    @property
    def head(self) -> HeadModel:
        """The head model that the tracking belongs to."""
        return self._character.head

    @property
    def identity(self) -> Float[ndarray, " I"]:
        """The person's identity coefficients."""
        return self._character.identity

    def render(self, index: int) -> tuple[UInt8[ndarray, "H W 3"], Float[ndarray, "H W"]]:
        """One frame on its background (8-bit sRGB) and the coverage of the person in [0, 1]."""
        geometry = pose_character(self._character, self._lips, self._performance, index)
        points = np.concatenate((geometry.head, geometry.torso, geometry.accessory))
        shadow = shadow_map(points, self._faces, self._lights)
        color, alpha, depth = self._surfaces(points, geometry, shadow)
        self._strands(geometry, index, shadow, color, alpha, depth)
        self._glass(geometry, shadow, color, depth)
        return self._composite(color, alpha)

    def _surfaces(self, points: ndarray, geometry: PosedGeometry, shadow: Shadow) -> tuple[ndarray, ndarray, ndarray]:
        """Premultiplied color, coverage and depth of all opaque surfaces, for every sample."""
        side = self._size * _SUPERSAMPLING
        seen = rasterize(project(points, room.intrinsics(side), room.room_to_camera()), self._faces, side, side)
        color = np.zeros((side, side, 3), np.float32)
        mesh = Mesh(
            points.astype(np.float32),
            vertex_normals(points, self._faces),
            self._sky_visibility(geometry),
            self._faces,
            self._uv,
            self._material,
        )
        shade(seen.face, seen.weights, mesh, self._textures(geometry), self._lights, shadow, color)
        return color, (seen.face >= 0).astype(np.float32), seen.depth

    def _sky_visibility(self, geometry: PosedGeometry) -> Float[ndarray, "V 1"]:
        """Sky visibility of the vertices: baked, but in the mouth by lip opening and depth behind the lips."""
        visibility = self._character.occlusion.copy()
        fine = self._character.fine.faces
        inside = np.unique(fine[self._character.material == MOUTH])
        depth = np.clip(0.053 - self._character.rest[inside, 2], 0.0, 0.08)
        opening = geometry.mouth_open
        visibility[inside] = np.clip((opening + 0.0008) / (opening + 0.0008 + 0.35 * depth), 0.02, 1.0)
        return visibility[:, None]

    def _textures(self, geometry: PosedGeometry) -> Textures:
        """Textures of this frame, with the current folds added to the head's relief."""
        relief = self._character.relief.copy()
        add_folds(relief[0], self._character.folds, geometry.values, self._character.person.skin.age)
        return Textures(self._character.albedo, relief, self._character.materials)

    def _strands(
        self, geometry: PosedGeometry, index: int, shadow: Shadow, color: ndarray, alpha: ndarray, depth: ndarray
    ) -> None:
        """Rasterize brows, lashes, beard and hair over the surfaces, in place."""
        side = self._size * _SUPERSAMPLING
        scalp_hair, hair = self._character.scalp_hair, self._character.person.hair
        parts = [
            (item.posed(geometry.head), item.colors, item.widths, np.full(item.local.shape[:2], 0.85))
            for item in self._character.short_hair
        ]
        nodes = swing_hair(scalp_hair.nodes, self._performance.head_to_room[index], self._lags[:, index], hair.flex)
        parts.append((nodes, self._hair_color, np.full(len(nodes), hair.width), scalp_hair.ambient_visibility))
        strands = []
        for nodes, tones, widths, ambient_visibility in parts:
            pixels = project(nodes.reshape(-1, 3), room.intrinsics(side), room.room_to_camera()).reshape(nodes.shape)
            taper = np.interp(np.linspace(0, 1, nodes.shape[1]), [0, 0.5, 1.0], [1.0, 0.95, 0.35])
            size = widths[:, None] * taper * room.intrinsics(side)[0, 0] / pixels[..., 2]
            strands.append(Strands(pixels, strand_colors(nodes, tones, ambient_visibility, self._lights, shadow), size))
        rasterize_strands(strands, depth, color, alpha)

    def _glass(self, geometry: PosedGeometry, shadow: Shadow, color: ndarray, depth: ndarray) -> None:
        """Render the lenses' slight tint and reflection of the key light, in place."""
        lens = self._character.lens
        if not len(lens.faces):
            return
        side = self._size * _SUPERSAMPLING
        seen = rasterize(project(geometry.lens, room.intrinsics(side), room.room_to_camera()), lens.faces, side, side)
        face = np.where(seen.depth < depth, seen.face, -1)
        mesh = Mesh(
            geometry.lens.astype(np.float32),
            vertex_normals(geometry.lens, lens.faces),
            np.ones((len(geometry.lens), 1), np.float32),
            lens.faces.astype(np.int64),
            lens.uv,
            np.full(len(lens.faces), LENS, np.uint8),
        )
        shine = np.zeros_like(color)
        black = Textures(np.zeros((3, 2, 2, 3), np.float32), np.zeros((3, 2, 2), np.float32), self._character.materials)
        shade(face, seen.weights, mesh, black, self._lights, shadow, shine)
        color[face >= 0] = 0.93 * color[face >= 0] + 0.35 * shine[face >= 0]

    def _composite(self, color: ndarray, alpha: ndarray) -> tuple[ndarray, ndarray]:
        """Expose and average the samples, and composite the person over the background in sRGB."""
        exposed = 1 - np.exp(-_EXPOSURE * 1.25 * color)
        premultiplied, coverage = _average_2x2(exposed), _average_2x2(alpha)
        straight = to_srgb(premultiplied / np.maximum(coverage, 1e-4)[..., None])
        image = straight * coverage[..., None] + self._background * (1 - coverage[..., None])
        return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8), coverage


def _average_2x2(samples: ndarray) -> ndarray:
    """Averages of 2 × 2 samples."""
    return 0.25 * (samples[::2, ::2] + samples[1::2, ::2] + samples[::2, 1::2] + samples[1::2, 1::2])


def _joined(character: Character) -> tuple[ndarray, ndarray, ndarray]:
    """Faces, texture coordinates and materials of head, garment and accessory with one vertex numbering."""
    pieces = (character.torso, character.accessory)
    starts = np.cumsum([len(character.rest), len(character.torso.points)])
    faces = [character.fine.faces, *(piece.faces + start for piece, start in zip(pieces, starts, strict=True))]
    uv = [character.uv, *(piece.uv for piece in pieces)]
    material = [character.material, *(piece.material for piece in pieces)]
    return np.concatenate(faces), np.concatenate(uv), np.concatenate(material)
