"""Everything about a generated person that does not change from frame to frame: meshes, textures, strands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.identity import warp_points
from ggavatar.head.procedural.model import procedural_head, procedural_names
from ggavatar.head.procedural.parts import Part
from preprocess.synthetic.person.accessories import beanie, glasses_frame, lenses
from preprocess.synthetic.person.description import PEOPLE, Person
from preprocess.synthetic.person.hair import ScalpHair, grow_scalp_hair, sample_surface, scalp_density
from preprocess.synthetic.person.lashes import lashes
from preprocess.synthetic.person.short_hair import ShortHair, beard, brows
from preprocess.synthetic.person.skin_paint import paint_head, paint_relief
from preprocess.synthetic.person.subdivision import Subdivision, subdivide
from preprocess.synthetic.person.texture_space import Texels, locate_texels, noise, to_linear
from preprocess.synthetic.person.torso import build_torso, paint_garment
from preprocess.synthetic.person.wrinkles import FoldPatch, bulge_fields, fold_patches
from preprocess.synthetic.rendering.lights import sky_visibility
from preprocess.synthetic.rendering.mesh import vertex_normals

TEXTURE = 1024
"""Width and height of every texture."""
SKIN, EYE, MOUTH, LIPS, CLOTH, HAT, FRAME, LENS = range(8)


@dataclass(frozen=True)
class RigidMesh:
    """A rigid mesh other than the head: garment, glasses, hat or lenses.

    Attributes:
        points: Vertices at rest, m.
        faces: Triangles.
        uv: Texture coordinates of every corner.
        material: Material of each face.
    """

    points: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    uv: Float[ndarray, "F 3 2"]
    material: UInt8[ndarray, " F"]


@dataclass(frozen=True)
class Character:
    """A person, ready to be animated.

    Attributes:
        person: The description.
        identity: Identity coefficients.
        head: The head model that the tracking belongs to.
        fine: Subdivision of its triangles.
        uv: Texture coordinates of the fine corners.
        material: Material of the fine faces.
        occlusion: Sky visibility of the fine vertices, then of those of garment and accessory.
        rest: Position of the fine vertices on the generic head, m.
        torso: The garment.
        accessory: Glasses or hat, fixed to the head; empty without either.
        lens: Lenses; empty without glasses.
        albedo: Linear colors of the head's, the garment's and the accessory's texture.
        relief: Heights of the same textures, m.
        folds: Pieces of the head's relief that appear with expressions.
        bulges: Displacements of the fine vertices that appear with expressions, m.
        scalp_hair: Scalp hair.
        short_hair: Brows, beard and lashes.
        materials: One row per material for the shader.
    """

    person: Person
    identity: Float[ndarray, " I"]
    head: HeadModel
    fine: Subdivision
    uv: Float[ndarray, "G 3 2"]
    material: UInt8[ndarray, " G"]
    occlusion: Float[ndarray, " A"]
    rest: Float[ndarray, "W 3"]
    torso: RigidMesh
    accessory: RigidMesh
    lens: RigidMesh
    albedo: Float[ndarray, "3 R R 3"]
    relief: Float[ndarray, "3 R R"]
    folds: list[FoldPatch]
    bulges: Float[ndarray, "B 2 W 3"]
    scalp_hair: ScalpHair
    short_hair: tuple[ShortHair, ...]
    materials: Float[ndarray, "M 5"]


def build_character(number: int) -> Character:
    """One of the five people (1 to 5), built deterministically."""
    person = PEOPLE[number]
    names = procedural_names()[1]
    identity = np.array([person.identity.get(name, 0.0) for name in names])
    head, generic = procedural_head(identity), procedural_head()
    faces = head.faces.numpy()
    fine = subdivide(faces, len(head.template))
    rest = fine.weights @ generic.template.numpy().astype(np.float64)
    shape = fine.weights @ head.template.numpy().astype(np.float64)
    groups = _face_groups(head)
    assert head.uv is not None
    texels = locate_texels(generic.template.numpy().astype(np.float64), faces, head.uv.numpy(), TEXTURE)
    torso, accessory, lens = _torso(person), _accessory(person, identity), _lens(person, identity)
    albedo, relief = _textures(texels, groups, person, number)
    on_skin = np.isin(np.arange(len(rest)), fine.faces[np.repeat(_membership(groups["skin"], faces), 4)])
    return Character(
        person=person,
        identity=identity,
        head=head,
        fine=fine,
        uv=fine.corners(head.uv.numpy()).astype(np.float32),
        material=np.repeat(_materials_of_faces(head, groups), 4),
        occlusion=_occlusion(shape, fine.faces, torso, accessory),
        rest=rest,
        torso=torso,
        accessory=accessory,
        lens=lens,
        albedo=albedo,
        relief=relief,
        folds=fold_patches(texels),
        bulges=bulge_fields(rest, on_skin),
        scalp_hair=_scalp_hair(generic, identity, person, groups, number),
        short_hair=_short_hair(head, fine, rest, groups, person, number),
        materials=_shader_rows(person),
    )


def _face_groups(head: HeadModel) -> dict[str, ndarray]:
    """Faces of every anatomical part."""
    faces = head.faces.numpy()
    pieces = ("skin", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "left_ear", "right_ear")
    groups = {name: np.flatnonzero(np.isin(faces, head.regions[name].numpy()).all(axis=1)) for name in pieces}
    taken = np.concatenate(list(groups.values()))
    return groups | {"mouth_bag": np.setdiff1d(np.arange(len(faces)), taken)}


def _membership(rows: ndarray, faces: ndarray) -> ndarray:
    mask = np.zeros(len(faces), bool)
    mask[rows] = True
    return mask


def _materials_of_faces(head: HeadModel, groups: dict[str, ndarray]) -> UInt8[ndarray, " F"]:
    """Material of every coarse face."""
    material = np.full(len(head.faces), SKIN, np.uint8)
    for name in ("left_eyeball", "right_eyeball"):
        material[groups[name]] = EYE
    for name in ("mouth_bag", "tongue", "upper_teeth", "lower_teeth"):
        material[groups[name]] = MOUTH
    lips = np.isin(head.faces.numpy(), head.regions["lips"].numpy()).all(axis=1)
    material[lips & (material == SKIN)] = LIPS
    return material


def _shader_rows(person: Person) -> Float[ndarray, "M 5"]:
    """Texture, roughness, gloss, scattering and mirror of every material."""
    gloss = person.skin.gloss
    return np.array(
        [
            (0, 0.46, 1.15 * gloss, 1.0, 0.0),
            (0, 0.30, 0.40, 0.30, 1.0),
            (0, 0.30, 0.90, 1.3, 0.0),
            (0, 0.34, 1.40, 0.80, 0.0),
            (1, 0.80, 0.30, 0.15, 0.0),
            (2, 0.85, 0.25, 0.15, 0.0),
            (2, 0.28, 1.60, 0.0, 0.6),
            (2, 0.10, 0.0, 0.0, 1.0),
        ],
        np.float32,
    )


def _torso(person: Person) -> RigidMesh:
    torso = build_torso(person.garment)
    return RigidMesh(torso.points, torso.faces, torso.uv.astype(np.float32), np.full(len(torso.faces), CLOTH, np.uint8))


def _placed(part: Part, uv: ndarray, identity: ndarray, material: int) -> RigidMesh:
    points = warp_points(part.vertices, identity * _rigid_identity())
    return RigidMesh(
        points, part.faces, uv[part.faces].astype(np.float32), np.full(len(part.faces), material, np.uint8)
    )


def _rigid_identity() -> Float[ndarray, " I"]:
    """1 for identity coefficients that change where hats and glasses sit, else 0."""
    kept = ("head_width", "head_height", "head_depth", "nose_bridge", "eye_distance", "brow_ridge")
    return np.array([float(name in kept) for name in procedural_names()[1]])


def _accessory(person: Person, identity: ndarray) -> RigidMesh:
    """Glasses (texture coordinates in the lowest tenth) or a hat (above), or an empty mesh."""
    if person.glasses is not None:
        part = glasses_frame()
        return _placed(part, np.full((len(part.vertices), 2), 0.05), identity, FRAME)
    if person.hat is not None:
        part, uv = beanie()
        return _placed(part, uv * (1.0, 0.85) + (0.0, 0.13), identity, HAT)
    return _no_mesh()


def _lens(person: Person, identity: ndarray) -> RigidMesh:
    if person.glasses is None:
        return _no_mesh()
    part = lenses()
    return _placed(part, np.full((len(part.vertices), 2), 0.05), identity, LENS)


def _no_mesh() -> RigidMesh:
    return RigidMesh(
        np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3, 2), np.float32), np.zeros(0, np.uint8)
    )


def _textures(texels: Texels, groups: dict[str, ndarray], person: Person, seed: int) -> tuple[ndarray, ndarray]:
    """Linear colors and heights of head, garment and accessory textures."""
    head, head_relief = (
        to_linear(paint_head(texels, groups, person, seed * 100)),
        paint_relief(texels, groups, seed * 100),
    )
    cloth, cloth_relief = paint_garment(person.garment, TEXTURE, seed * 100 + 50)
    other, other_relief = _paint_accessory(person, seed * 100 + 70)
    return np.stack((head, cloth, other)).astype(np.float32), np.stack(
        (head_relief, cloth_relief, other_relief)
    ).astype(np.float32)


def _paint_accessory(person: Person, seed: int) -> tuple[ndarray, ndarray]:
    """Linear color and height of the accessory texture: knitted wool above, the color of the glasses below."""
    v, u = np.meshgrid((np.arange(TEXTURE) + 0.5) / TEXTURE, (np.arange(TEXTURE) + 0.5) / TEXTURE, indexing="ij")
    ribs = np.sin(2 * np.pi * 88 * u)
    stitches = np.sin(2 * np.pi * 120 * v + 1.5 * ribs)
    flat = np.stack((u.ravel(), v.ravel(), np.zeros(u.size)), axis=1)
    wool = (0.86 + 0.10 * ribs + 0.05 * stitches) * (1 + 0.08 * noise(flat, 0.01, seed).reshape(u.shape))
    image = np.asarray(person.hat or (0.5, 0.5, 0.5)) * wool[..., None]
    image[v < 0.1] = person.glasses or (0.1, 0.1, 0.1)
    relief = np.where(v < 0.1, 0.0, 0.0007 * ribs + 0.00025 * stitches)
    return to_linear(image), relief


def _occlusion(shape: ndarray, faces: ndarray, torso: RigidMesh, accessory: RigidMesh) -> Float[ndarray, " A"]:
    """Sky visibility of head, garment and accessory vertices at rest, in this order."""
    points = np.concatenate((shape, torso.points, accessory.points))
    starts = np.cumsum((0, len(shape), len(torso.points)))
    joined = np.concatenate(
        [part + start for part, start in zip((faces, torso.faces, accessory.faces), starts, strict=True)]
    )
    return sky_visibility(points, vertex_normals(points, joined).astype(np.float64), joined).astype(np.float32)


def _scalp_hair(
    generic: HeadModel, identity: ndarray, person: Person, groups: dict[str, ndarray], seed: int
) -> ScalpHair:
    """Scalp hair, grown on the generic head and warped to the person's identity."""
    points, faces = generic.template.numpy().astype(np.float64), generic.faces.numpy()
    density = scalp_density(points[faces].mean(axis=1), _membership(groups["skin"], faces))
    if person.hat is not None:
        density = density * (points[faces].mean(axis=1)[:, 1] < 0.045)
    face, weights = sample_surface(points, faces, density, person.hair.strands, np.random.default_rng([seed, 2]))
    scalp_hair = grow_scalp_hair(np.einsum("sk,skc->sc", weights, points[faces[face]]), person.hair, seed)
    nodes = warp_points(scalp_hair.nodes.reshape(-1, 3), identity * _rigid_identity()).reshape(scalp_hair.nodes.shape)
    return ScalpHair(nodes, scalp_hair.tone, scalp_hair.ambient_visibility)


def _short_hair(
    head: HeadModel,
    fine: Subdivision,
    rest: ndarray,
    groups: dict[str, ndarray],
    person: Person,
    seed: int,
) -> tuple[ShortHair, ...]:
    """Brows, beard and lashes, placed on the generic head and attached to the subdivided skin."""
    skin = np.repeat(_membership(groups["skin"], head.faces.numpy()), 4)
    loops = tuple(_fine_loop(head.regions[name].numpy(), fine) for name in ("left_lid_margin", "right_lid_margin"))
    made = (brows(rest, fine.faces, skin, person, seed), beard(rest, fine.faces, skin, person, seed))
    found = [item for item in made if item is not None]
    return (*found, lashes(rest, (loops[0], loops[1]), fine.faces[skin], person, seed))


def _fine_loop(loop: ndarray, fine: Subdivision) -> ndarray:
    """A coarse vertex loop with the fine vertices of its edges in between."""
    weights = fine.weights.tocsc()
    middle = []
    for first, second in zip(loop, np.roll(loop, -1), strict=True):
        both = np.intersect1d(weights[:, [first]].nonzero()[0], weights[:, [second]].nonzero()[0])
        values = weights[both][:, [first, second]].toarray().min(axis=1)
        middle.append(both[np.argmax(values)])
    return np.stack((loop, np.asarray(middle)), axis=1).ravel()
