"""Descriptions of the five generated people."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Color = tuple[float, float, float]


@dataclass(frozen=True)
class Skin:
    """Appearance of the skin; colors are sRGB.

    Attributes:
        tone: Base color.
        flush: Color of cheeks, nose and ears, where blood shows through.
        lips: Color of the vermilion.
        freckles: Strength of freckles, 0 to 1.
        stubble: Darkness of the shaved beard, 0 to 1.
        age: Depth of wrinkles at rest, 0 to 1.
        gloss: Factor on the highlights.
    """

    tone: Color
    flush: Color
    lips: Color
    freckles: float = 0.0
    stubble: float = 0.0
    age: float = 0.15
    gloss: float = 1.0


@dataclass(frozen=True)
class HairStyle:
    """A hairstyle.

    Attributes:
        color: Color of the strands, sRGB.
        strands: Number of strands.
        length: Mean length on the crown, m.
        fringe: Length above the forehead, m.
        comb: Direction of the strands near the roots: +x left, +y up, +z forward.
        lift: How far the strands stand off the head at the roots, 0 to 1.
        curl: Radius of the waves, m.
        wave: Waves per meter.
        flex: How much the hair lags behind the head, 0 to 1.
        part: x of the parting, m; None combs all hair the same way.
        width: Width of a strand, m.
    """

    color: Color
    strands: int
    length: float
    fringe: float
    comb: Color = (0.0, 0.0, -1.0)
    lift: float = 0.4
    curl: float = 0.002
    wave: float = 30.0
    flex: float = 0.4
    part: float | None = None
    width: float = 0.00016


@dataclass(frozen=True)
class Beard:
    """A full beard.

    Attributes:
        strands: Number of strands.
        length: Longest strand, m.
        color: Color, sRGB.
    """

    strands: int
    length: float
    color: Color


@dataclass(frozen=True)
class Garment:
    """A garment.

    Attributes:
        color: Main color, sRGB.
        accent: Second color, sRGB.
        pattern: Pattern of the cloth.
        neckline: How far the neckline drops in front, m.
        collar: Height of the collar, m.
    """

    color: Color
    accent: Color
    pattern: Literal["plain", "stripes", "knit", "shirt"] = "knit"
    neckline: float = 0.02
    collar: float = 0.006


@dataclass(frozen=True)
class Person:
    """Description of one person; colors are sRGB.

    Attributes:
        identity: Identity coefficients by name.
        skin: Skin.
        iris: Color of the irises.
        hair: Scalp hair.
        brow: Color of the eyebrows.
        garment: Garment.
        brow_weight: Density of the eyebrows, about 1.
        lashes: Fullness of the lashes, about 0.3 to 1.2.
        beard: Beard, or None.
        glasses: Color of the glasses' frame, or None.
        hat: Color of the hat, or None.
        wall: Color of the wall behind.
    """

    identity: dict[str, float]
    skin: Skin
    iris: Color
    hair: HairStyle
    brow: Color
    garment: Garment
    brow_weight: float = 1.0
    lashes: float = 0.7
    beard: Beard | None = None
    glasses: Color | None = None
    hat: Color | None = None
    wall: Color = field(default=(0.62, 0.66, 0.68))


PEOPLE: dict[int, Person] = {
    1: Person(
        identity={
            "cheekbones": 0.5,
            "chin_forward": 0.4,
            "jaw_width": -0.3,
            "nose_length": 0.2,
            "eye_opening": 0.6,
            "lip_fullness": 0.2,
        },
        skin=Skin((0.84, 0.65, 0.55), (0.80, 0.47, 0.40), (0.72, 0.42, 0.39), freckles=0.25, stubble=0.32),
        iris=(0.30, 0.42, 0.50),
        hair=HairStyle(
            (0.26, 0.16, 0.10),
            16000,
            0.068,
            0.072,
            comb=(0.75, -0.10, -0.55),
            lift=0.30,
            curl=0.0026,
            wave=24.0,
            flex=0.45,
            part=-0.034,
        ),
        brow=(0.22, 0.14, 0.09),
        lashes=0.35,
        garment=Garment((0.16, 0.24, 0.33), (0.80, 0.78, 0.74), "knit", 0.018, 0.008),
        wall=(0.66, 0.68, 0.67),
    ),
    2: Person(
        identity={
            "jaw_width": -1.3,
            "chin_width": -0.7,
            "brow_ridge": -1.4,
            "lip_fullness": 1.1,
            "nose_width": -0.7,
            "nose_length": -0.5,
            "nose_bridge": -0.4,
            "eye_opening": 1.1,
            "neck_width": -1.4,
            "cheek_fullness": 0.5,
            "lower_face_length": -0.6,
            "eye_slant": 0.6,
            "head_width": -0.4,
        },
        skin=Skin((0.87, 0.69, 0.57), (0.84, 0.50, 0.44), (0.76, 0.36, 0.38), age=0.05, gloss=1.1),
        iris=(0.30, 0.18, 0.10),
        hair=HairStyle(
            (0.10, 0.065, 0.05),
            15000,
            0.260,
            0.230,
            comb=(0.75, 0.25, -0.65),
            lift=0.16,
            curl=0.0045,
            wave=16.0,
            flex=0.8,
            part=0.008,
        ),
        brow=(0.12, 0.08, 0.06),
        garment=Garment((0.58, 0.20, 0.22), (0.75, 0.40, 0.36), "plain", 0.040, 0.004),
        brow_weight=0.75,
        lashes=1.2,
        wall=(0.70, 0.66, 0.60),
    ),
    3: Person(
        identity={
            "nose_width": 1.5,
            "lip_fullness": 1.3,
            "nose_bridge": -0.9,
            "jaw_width": 0.7,
            "neck_width": 0.8,
            "cheekbones": 0.7,
            "head_depth": 0.4,
            "nose_length": -0.2,
            "mouth_width": 0.5,
            "chin_width": 0.6,
        },
        skin=Skin((0.42, 0.27, 0.20), (0.42, 0.22, 0.16), (0.42, 0.24, 0.21), age=0.2, gloss=1.7),
        iris=(0.17, 0.10, 0.06),
        hair=HairStyle(
            (0.045, 0.035, 0.03), 9000, 0.012, 0.010, comb=(0.0, 0.3, -0.4), lift=0.7, curl=0.0015, wave=160.0, flex=0.0
        ),
        brow=(0.05, 0.04, 0.035),
        lashes=0.6,
        garment=Garment((0.78, 0.62, 0.26), (0.30, 0.26, 0.22), "stripes", 0.020, 0.007),
        brow_weight=1.15,
        beard=Beard(9000, 0.014, (0.05, 0.04, 0.035)),
        hat=(0.16, 0.32, 0.30),
        wall=(0.60, 0.64, 0.58),
    ),
    4: Person(
        identity={
            "head_height": 0.5,
            "lower_face_length": 0.9,
            "nose_length": 1.1,
            "nose_bridge": 0.9,
            "lip_fullness": -1.0,
            "cheek_fullness": -0.9,
            "brow_ridge": 0.5,
            "ears_out": 0.8,
            "jaw_width": -0.2,
            "forehead_slope": 0.7,
            "eye_opening": -0.3,
            "nose_tip_up": -0.6,
        },
        skin=Skin((0.84, 0.66, 0.58), (0.80, 0.48, 0.42), (0.68, 0.43, 0.41), stubble=0.12, age=1.0, gloss=0.9),
        iris=(0.38, 0.45, 0.40),
        hair=HairStyle(
            (0.62, 0.60, 0.57),
            12000,
            0.046,
            0.042,
            comb=(-0.75, 0.05, -0.65),
            lift=0.24,
            curl=0.0014,
            wave=24.0,
            flex=0.25,
            part=0.030,
        ),
        brow=(0.45, 0.43, 0.41),
        lashes=0.3,
        garment=Garment((0.86, 0.88, 0.92), (0.45, 0.55, 0.72), "shirt", 0.034, 0.010),
        glasses=(0.09, 0.07, 0.06),
        wall=(0.58, 0.62, 0.66),
    ),
    5: Person(
        identity={
            "jaw_width": -0.8,
            "cheek_fullness": 1.2,
            "nose_tip_up": 0.9,
            "nose_length": -0.6,
            "brow_ridge": -1.0,
            "lower_face_length": -0.9,
            "eye_opening": 0.9,
            "mouth_width": 0.7,
            "head_width": 0.5,
            "lip_fullness": 0.4,
            "neck_width": -1.1,
            "chin_width": -0.3,
            "eye_distance": 0.4,
        },
        skin=Skin((0.90, 0.71, 0.63), (0.88, 0.52, 0.46), (0.80, 0.45, 0.44), freckles=1.0, age=0.08),
        iris=(0.28, 0.45, 0.32),
        hair=HairStyle(
            (0.60, 0.28, 0.12),
            15000,
            0.165,
            0.150,
            comb=(0.75, 0.2, -0.60),
            lift=0.22,
            curl=0.0070,
            wave=30.0,
            flex=0.65,
            part=-0.012,
        ),
        brow=(0.46, 0.24, 0.12),
        garment=Garment((0.25, 0.42, 0.34), (0.88, 0.84, 0.72), "stripes", 0.022, 0.005),
        brow_weight=0.8,
        lashes=0.9,
        wall=(0.66, 0.64, 0.70),
    ),
}
