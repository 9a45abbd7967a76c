"""Planted faults in the conventions of other trackers' formats, and in crops."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

TEST = "tests/preprocess/formats/importers/test_importers.py"
ROUND_TRIP = f"{TEST}::test_round_trip_keeps_projections"

MUTATIONS = (
    Mutation(
        "metrical_tracker_size_as_width_and_height",
        "preprocess/formats/importers/metrical_tracker.py",
        "height, width = image_size(content)",
        "width, height = image_size(content)",
        (ROUND_TRIP,),
    ),
    Mutation(
        "metrical_tracker_eyes_swapped",
        "preprocess/formats/importers/metrical_tracker.py",
        "(flame.array(_JAW, (6,), (3,)), *eyes)",
        "(flame.array(_JAW, (6,), (3,)), *eyes[::-1])",
        (f"{TEST}::test_eyes_are_in_joint_order",),
    ),
    Mutation(
        "metrical_tracker_jaw_ignored",
        "preprocess/formats/importers/metrical_tracker.py",
        "joints[2:] = axis_angles_of(flame.array(_JAW, (6,), (3,)), *eyes)",
        "joints[3:] = axis_angles_of(*eyes)",
        (ROUND_TRIP,),
    ),
    Mutation(
        "imavatar_lengths_in_meters",
        "preprocess/formats/importers/imavatar.py",
        "SCALE = 4.0",
        "SCALE = 1.0",
        (f"{TEST}::test_imavatar_traps",),
    ),
    Mutation(
        "imavatar_cameras_as_opencv",
        "preprocess/formats/importers/imavatar.py",
        "FLIP = np.diag([1.0, -1.0, -1.0])",
        "FLIP = np.diag([1.0, 1.0, 1.0])",
        (f"{TEST}::test_imavatar_traps",),
    ),
    Mutation(
        "vhap_cameras_as_opencv",
        "preprocess/formats/json_fields.py",
        "return invert_pose(matrix @ np.diag([1.0, -1.0, -1.0, 1.0]))",
        "return invert_pose(matrix)",
        (ROUND_TRIP,),
    ),
    Mutation(
        "opengl_flipped_on_the_wrong_side",
        "preprocess/formats/json_fields.py",
        "return invert_pose(matrix @ np.diag([1.0, -1.0, -1.0, 1.0]))",
        "return invert_pose(np.diag([1.0, -1.0, -1.0, 1.0]) @ matrix)",
        (ROUND_TRIP,),
    ),
    Mutation(
        "insta_matrices_not_inverted",
        "preprocess/formats/importers/insta.py",
        "world_to_camera=np.stack([invert_pose(matrix) for matrix in matrices])",
        "world_to_camera=np.stack(matrices)",
        (ROUND_TRIP,),
    ),
    Mutation(
        "vhap_neck_and_root_swapped",
        "preprocess/formats/importers/vhap.py",
        '        "rotation": joints[0][None],\n        "neck_pose": joints[1][None],',
        '        "rotation": joints[1][None],\n        "neck_pose": joints[0][None],',
        (ROUND_TRIP,),
    ),
    Mutation(
        "nerface_without_half_a_pixel",
        "preprocess/formats/importers/nerface.py",
        "lens[2] * width + 0.5, lens[3] * height + 0.5",
        "lens[2] * width, lens[3] * height",
        (ROUND_TRIP,),
    ),
    Mutation(
        "nerface_not_mirrored",
        "preprocess/formats/importers/nerface.py",
        "mirrored = np.sign(lens[0])",
        "mirrored = 1.0",
        (ROUND_TRIP,),
    ),
    Mutation(
        "nerfblendshape_without_half_a_pixel",
        "preprocess/formats/importers/nerfblendshape.py",
        "center_x + 0.5, center_y + 0.5",
        "center_x, center_y",
        (ROUND_TRIP,),
    ),
    Mutation(
        "deca_crop_shifted",
        "preprocess/formats/weak_perspective.py",
        "pose[:3, 3] = [shift_x, -shift_y, FOCAL / (scale * SIDE / 2)]",
        "pose[:3, 3] = [shift_x, shift_y, FOCAL / (scale * SIDE / 2)]",
        (f"{TEST}::test_deca_codes",),
    ),
    Mutation(
        "flame_version_of_vhap",
        "preprocess/formats/importers/vhap.py",
        'version="flame2023"',
        'version="flame2020"',
        (f"{TEST}::test_vhap_keeps_static_offsets_and_reads_the_first_camera",),
    ),
    Mutation(
        "crop_does_not_shift_the_principal_point",
        "preprocess/video/crop.py",
        "shift = np.array([[1.0, 0, -self.x], [0, 1, -self.y], [0, 0, 1]])",
        "shift = np.eye(3)",
        ("tests/preprocess/video/test_crop.py::test_intrinsics_follow_the_pixels",),
    ),
    Mutation(
        "principal_point_scaled_about_pixel_centers",
        "preprocess/video/crop.py",
        "return scale @ shift @ source",
        "return shift @ scale @ source",
        ("tests/preprocess/video/test_crop.py::test_intrinsics_follow_the_pixels",),
    ),
)
