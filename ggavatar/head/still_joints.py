"""A joint regressor for head models whose joints are given as points that no expression moves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError

_STILL = 1e-6
_SHARE = 0.05


def still_joint_regressor(
    source: object,
    template: Float[np.ndarray, "V 3"],
    expression_basis: Float[np.ndarray, "V 3 E"],
    joints: Float[np.ndarray, "J 3"],
) -> Float[np.ndarray, "J V"]:
    """Weights whose sums over the template are the joints exactly and whose rows sum to 1, of least squares.

    `HeadModel` has joints as sums of shaped vertices. The weights lie on the vertices that expressions move less than
    1 µm, or else on the twentieth that they move least, so that joints hold still under expressions, and follow the
    head when it is moved as a whole.

    Raises:
        InputError: Those vertices are fewer than four, or lie in a plane.
    """
    motion = np.abs(expression_basis).max(axis=(1, 2), initial=0)
    rows = np.flatnonzero(motion <= max(_STILL, float(np.quantile(motion, _SHARE))))
    system = np.concatenate((template[rows].T, np.ones((1, len(rows)))))
    wanted = np.concatenate((joints.T, np.ones((1, len(joints)))))
    weights = np.linalg.pinv(system) @ wanted
    if np.abs(system @ weights - wanted).max() > 1e-6:
        raise InputError(
            f"{source}: expected vertices that hold still in all expressions, found too few; download it again"
        )
    regressor = np.zeros((len(joints), len(template)))
    regressor[:, rows] = weights.T
    return regressor
