"""Expression basis of the procedural head, built from a table of smooth, local shifts of the skin.

A shift moves the skin around a point along a vector with a Gaussian falloff. One unit of a coefficient is the full
expression; coefficients add up. The table lists the left half of the face (+X), lengths in m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ggavatar.head.procedural.skin import MOUTH_HALF_WIDTH, lip_line_height

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Shift:
    """A displacement of the skin with a Gaussian falloff.

    Attributes:
        center: Where it is strongest, m.
        falloff: Distance along x, y and z at which it has fallen to 1/e, m.
        vector: Displacement at the center, m.
        lips: "upper" or "lower" if it affects one lip only, else "both".
    """

    center: Vector
    falloff: Vector
    vector: Vector
    lips: str = "both"

    def field(
        self, points: Float[ndarray, "N 3"], lower: Float[ndarray, " N"], *, mirrored: bool
    ) -> Float[ndarray, "N 3"]:
        """Displacement of points, m.

        Args:
            points: On the generic head, m.
            lower: Their weight on the lower lip's side (`lower_lip_weight`).
            mirrored: Apply the shift to the right half instead of the left.
        """
        flip = np.array([-1.0, 1.0, 1.0]) if mirrored else np.ones(3)
        offset = (points * flip - self.center) / self.falloff
        weight = np.exp(-(offset**2).sum(axis=1))
        weight = weight * {"upper": 1 - lower, "lower": lower}.get(self.lips, 1.0)
        return weight[:, None] * (np.asarray(self.vector) * flip)


@dataclass(frozen=True)
class Expression:
    """A named group of shifts.

    Attributes:
        name: Of the coefficient; one per side appends `_left` and `_right`.
        shifts: What the expression consists of.
        sided: One coefficient for each half of the face, not one for both.
        tongue: Moves the tongue instead of the skin.
    """

    name: str
    shifts: tuple[Shift, ...]
    sided: bool = True
    tongue: bool = False


_CORNER: Vector = (0.0255, -0.0470, 0.0400)
_CORNER_FALLOFF: Vector = (0.0125, 0.0130, 0.030)
_UPPER: Vector = (0.0, -0.0430, 0.0530)
_LOWER: Vector = (0.0, -0.0510, 0.0520)

EXPRESSIONS = (
    Expression(
        "smile",
        (
            Shift(_CORNER, _CORNER_FALLOFF, (0.0078, 0.0068, -0.0050)),
            Shift((0.0130, -0.0470, 0.0480), (0.012, 0.012, 0.03), (0.0026, 0.0016, -0.0018)),
            Shift((0.0400, -0.0120, 0.0300), (0.017, 0.016, 0.03), (0.0020, 0.0046, 0.0038)),
            Shift((0.0310, 0.0165, 0.0350), (0.014, 0.005, 0.02), (0.0, 0.0012, 0.0003)),
        ),
    ),
    Expression(
        "frown",
        (
            Shift(_CORNER, _CORNER_FALLOFF, (0.0010, -0.0066, -0.0010)),
            Shift((0.0200, -0.0630, 0.0420), (0.014, 0.010, 0.03), (0.0, -0.0020, 0.0012)),
        ),
    ),
    Expression("stretch", (Shift(_CORNER, (0.014, 0.014, 0.03), (0.0090, -0.0010, -0.0060)),)),
    Expression("dimple", (Shift((0.0290, -0.0460, 0.0370), (0.008, 0.008, 0.02), (0.0030, 0.0006, -0.0046)),)),
    Expression(
        "upper_lip_raise",
        (
            Shift((0.0105, -0.0430, 0.0500), (0.010, 0.012, 0.03), (0.0, 0.0056, 0.0006), "upper"),
            Shift((0.0220, -0.0280, 0.0440), (0.010, 0.012, 0.03), (0.0005, 0.0030, 0.0012)),
        ),
    ),
    Expression(
        "lower_lip_depress",
        (Shift((0.0105, -0.0510, 0.0490), (0.010, 0.011, 0.03), (0.0006, -0.0058, 0.0002), "lower"),),
    ),
    Expression("cheek_puff", (Shift((0.0400, -0.0370, 0.0300), (0.019, 0.020, 0.03), (0.0065, 0.0, 0.0060)),)),
    Expression(
        "cheek_squint",
        (
            Shift((0.0380, 0.0040, 0.0330), (0.017, 0.010, 0.03), (0.0, 0.0040, 0.0016)),
            Shift((0.0310, 0.0170, 0.0360), (0.014, 0.005, 0.02), (0.0, 0.0018, 0.0004)),
        ),
    ),
    Expression(
        "nose_wrinkle",
        (
            Shift((0.0120, 0.0020, 0.0500), (0.010, 0.014, 0.03), (0.0, 0.0040, 0.0010)),
            Shift((0.0150, -0.0170, 0.0540), (0.007, 0.008, 0.02), (0.0006, 0.0032, 0.0)),
            Shift((0.0120, -0.0400, 0.0500), (0.012, 0.008, 0.03), (0.0, 0.0018, 0.0), "upper"),
        ),
    ),
    Expression("brow_outer_up", (Shift((0.0380, 0.0460, 0.0280), (0.016, 0.017, 0.03), (0.0, 0.0068, 0.0)),)),
    Expression(
        "brow_down",
        (
            Shift((0.0150, 0.0430, 0.0420), (0.015, 0.012, 0.03), (-0.0032, -0.0056, 0.0012)),
            Shift((0.0360, 0.0450, 0.0300), (0.014, 0.011, 0.03), (-0.0008, -0.0034, 0.0)),
        ),
    ),
    Expression("eye_wide", (Shift((0.0310, 0.0300, 0.0380), (0.014, 0.0042, 0.02), (0.0, 0.0022, -0.0012)),)),
    Expression(
        "eye_squint",
        (
            Shift((0.0310, 0.0180, 0.0370), (0.015, 0.0060, 0.02), (0.0, 0.0027, 0.0006)),
            Shift((0.0310, 0.0310, 0.0380), (0.015, 0.0050, 0.02), (0.0, -0.0013, 0.0003)),
        ),
    ),
    Expression(
        "pucker",
        (
            Shift(_CORNER, (0.011, 0.013, 0.03), (-0.0090, 0.0, 0.0060)),
            Shift((0.0, -0.0470, 0.0530), (0.014, 0.013, 0.03), (0.0, 0.0, 0.0032)),
        ),
        sided=False,
    ),
    Expression(
        "funnel",
        (
            Shift(_UPPER, (0.016, 0.012, 0.03), (0.0, 0.0016, 0.0020), "upper"),
            Shift(_LOWER, (0.016, 0.012, 0.03), (0.0, -0.0019, 0.0020), "lower"),
            Shift(_CORNER, (0.010, 0.012, 0.03), (-0.0046, 0.0, 0.0030)),
        ),
        sided=False,
    ),
    Expression(
        "lips_part",
        (
            Shift(_UPPER, (0.018, 0.008, 0.03), (0.0, 0.0011, 0.0), "upper"),
            Shift(_LOWER, (0.018, 0.009, 0.03), (0.0, -0.0016, 0.0), "lower"),
        ),
        sided=False,
    ),
    Expression(
        "lips_press",
        (
            Shift(_UPPER, (0.024, 0.008, 0.03), (0.0, -0.0003, -0.0009), "upper"),
            Shift(_LOWER, (0.024, 0.009, 0.03), (0.0, 0.0004, -0.0010), "lower"),
            Shift(_CORNER, (0.009, 0.009, 0.03), (0.0014, 0.0, -0.0020)),
        ),
        sided=False,
    ),
    Expression("upper_roll_in", (Shift(_UPPER, (0.022, 0.006, 0.03), (0.0, -0.0006, -0.0019), "upper"),), sided=False),
    Expression("lower_roll_in", (Shift(_LOWER, (0.022, 0.007, 0.03), (0.0, 0.0006, -0.0021), "lower"),), sided=False),
    Expression(
        "upper_lip_forward", (Shift(_UPPER, (0.018, 0.009, 0.03), (0.0, 0.0003, 0.0021), "upper"),), sided=False
    ),
    Expression(
        "lower_lip_forward", (Shift(_LOWER, (0.018, 0.009, 0.03), (0.0, -0.0003, 0.0023), "lower"),), sided=False
    ),
    Expression("lips_tighten", (Shift(_CORNER, (0.010, 0.010, 0.03), (-0.0040, 0.0, 0.0)),), sided=False),
    Expression(
        "chin_raise",
        (
            Shift((0.0, -0.0680, 0.0500), (0.020, 0.013, 0.03), (0.0, 0.0021, 0.0008), "lower"),
            Shift(_LOWER, (0.018, 0.009, 0.03), (0.0, 0.0005, 0.0006), "lower"),
        ),
        sided=False,
    ),
    Expression(
        "cheek_suck", (Shift((0.0410, -0.0340, 0.0300), (0.017, 0.018, 0.03), (-0.0045, 0.0, -0.0030)),), sided=False
    ),
    Expression(
        "nostril_flare", (Shift((0.0145, -0.0190, 0.0550), (0.006, 0.007, 0.02), (0.0022, 0.0006, 0.0)),), sided=False
    ),
    Expression(
        "brow_inner_up", (Shift((0.0125, 0.0450, 0.0430), (0.013, 0.016, 0.03), (0.0, 0.0064, 0.0)),), sided=False
    ),
    Expression("swallow", (Shift((0.0, -0.1180, -0.0050), (0.014, 0.012, 0.03), (0.0, 0.0045, 0.0006)),), sided=False),
    Expression("mouth_shift", (Shift((0.0, -0.0480, 0.0500), (0.034, 0.022, 0.05), (0.0058, 0.0, 0.0010)),)),
    Expression(
        "tongue_out",
        (Shift((0.0, -0.0530, 0.0400), (0.03, 0.02, 0.030), (0.0, 0.0022, 0.0110)),),
        sided=False,
        tongue=True,
    ),
    Expression(
        "tongue_up",
        (Shift((0.0, -0.0530, 0.0370), (0.03, 0.02, 0.018), (0.0, 0.0058, 0.0010)),),
        sided=False,
        tongue=True,
    ),
)


def expression_names() -> tuple[str, ...]:
    """Names of the expression coefficients, in the order of the basis."""
    return tuple(name for expression in EXPRESSIONS for name, _ in _coefficients(expression))


def _coefficients(expression: Expression) -> list[tuple[str, tuple[bool, ...]]]:
    """Coefficients of a table entry: name, and the `mirrored` flags of the halves that it moves."""
    if expression.sided:
        return [(f"{expression.name}_left", (False,)), (f"{expression.name}_right", (True,))]
    return [(expression.name, (False, True))]


def lower_lip_weight(points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
    """Weight of points on the lower lip's side: 0 above the line between the lips, 1 below.

    The step is sharp along the mouth, narrows towards its corners and is soft on the cheeks.
    """
    x = np.abs(points[:, 0])
    beyond = np.maximum(x - 0.96 * MOUTH_HALF_WIDTH, 0.0)
    width = 0.00005 + 0.9 * beyond
    hinge = lip_line_height(np.minimum(x, MOUTH_HALF_WIDTH)) + 0.46 * np.clip(
        0.037 - points[:, 2], 0.0, 0.06
    ) * np.clip(beyond / 0.01, 0, 1)
    step = np.clip((hinge - points[:, 1]) / np.minimum(width, 0.016) * 0.5 + 0.5, 0.0, 1.0)
    corner = np.clip((x / MOUTH_HALF_WIDTH - 0.30) / 0.70, 0.0, 1.0) ** 2 * np.exp(
        -((np.maximum(beyond, 0) / 0.004) ** 2)
    )
    near = np.exp(-(((points[:, 1] - lip_line_height(x)) / 0.012) ** 2))
    return 0.5 + (step * step * (3 - 2 * step) - 0.5) * (1 - 0.92 * corner * near)


def expression_basis(
    points: Float[ndarray, "V 3"], lower: Float[ndarray, " V"], on_skin: ndarray, on_tongue: ndarray
) -> Float[ndarray, "V 3 E"]:
    """Displacement per unit of every coefficient, m.

    Args:
        points: Vertices of the generic head, m.
        lower: Their weight on the lower lip's side.
        on_skin: Mask of the skin's vertices.
        on_tongue: Mask of the tongue's vertices.
    """
    columns = []
    for expression in EXPRESSIONS:
        chosen = on_tongue if expression.tongue else on_skin
        for _, halves in _coefficients(expression):
            total = np.zeros_like(points)
            for shift in expression.shifts:
                for mirrored in halves:
                    total += shift.field(points, lower, mirrored=mirrored)
            columns.append(np.where(chosen[:, None], total, 0.0))
    return np.stack(columns, axis=2)
