"""The torso's pose of a tracked head, whose neck has two joints and a length, and back again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ggavatar.head.model import HeadModel
from preprocess.tracking.geometry.rigid import RigidPoses
from preprocess.tracking.head.personal_head import NECK_UNIT, VERSION
from preprocess.tracking.torso.torso import NeckJoints, neck_motion


@dataclass(frozen=True)
class Neck:
    """Where a tracked head keeps the motion of its torso.

    Attributes:
        joints: Positions of its two joints, m.
        upper: Row of the upper joint among the head's joints.
        lower: Row of the lower joint.
    """

    joints: NeckJoints
    upper: int
    lower: int

    @staticmethod
    def of(head: HeadModel) -> Neck | None:
        """The neck of a head that our tracker made; None for another head."""
        if head.version != VERSION:
            return None
        upper, lower = head.joint_index("cervical"), head.joint_index("torso")
        places = (head.joint_regressor @ head.template).double().numpy()
        return Neck(NeckJoints(places[upper], places[lower]), upper, lower)

    def torso_in_head(
        self, expression: Float[np.ndarray, "T E"], rotations: Float[np.ndarray, "T J 3"]
    ) -> Float[np.ndarray, "T 4 4"]:
        """Rigid transform of the torso in head space: the inverse of `neck_motion`."""
        upper = Rotation.from_rotvec(rotations[:, self.upper])
        turned = (upper * Rotation.from_rotvec(rotations[:, self.lower])).as_matrix()
        arm = self.joints.lower - self.joints.upper
        length = np.linalg.norm(arm)
        arms = arm * (1 + NECK_UNIT * expression[:, -1:] / length)
        result = np.tile(np.eye(4), (len(expression), 1, 1))
        result[:, :3, :3] = turned
        result[:, :3, 3] = self.joints.upper + upper.apply(arms) - turned @ self.joints.lower
        return result

    def with_torso(
        self,
        expression: Float[np.ndarray, "T E"],
        rotations: Float[np.ndarray, "T J 3"],
        head: Float[np.ndarray, "T 4 4"],
        torso: Float[np.ndarray, "T 4 4"],
    ) -> tuple[Float[np.ndarray, "T E"], Float[np.ndarray, "T J 3"]]:
        """Expression and joint rotations with the neck's motion replaced by that which brings the torso to its pose."""
        at_torso, at_head = (RigidPoses(pose[:, :3, :3], pose[:, :3, 3]) for pose in (torso, head))
        motion = neck_motion(at_torso, at_head, self.joints)
        expression, rotations = expression.copy(), rotations.copy()
        expression[:, -1] = motion.stretch / NECK_UNIT
        rotations[:, self.upper], rotations[:, self.lower] = motion.upper, motion.lower
        return expression, rotations
