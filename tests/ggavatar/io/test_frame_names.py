"""Numbers in names. Reference: the naming rules of the tools that write such names, given with each case."""

from __future__ import annotations

import pytest

from ggavatar.errors import InputError
from ggavatar.io.frame_names import frame_numbers

FRAMES = [0, 1, 2, 10, 11, 12]
ONE_NUMBER = {
    "ffmpeg %06d": "{0:06d}",
    "unpadded": "{0}",
    "a word before": "frame_{0:04d}",
    "a word behind": "{0:05d}_mask",
    "VHAP %05d_%02d of one camera": "{0:05d}_00",
    "EMOCA's folders": "{0:06d}_000",
    "a take and a resolution": "take2_1920x1080_{0:04d}",
    "a year": "2024-05-01_{0}",
    "a resolution behind": "{0:04d}_512x512",
    "a camera before": "cam3_frame{0}",
    "NeRSemble's serial number": "cam_222200037/frame_{0:05d}",
    "a path of transforms.json": "./images/{0:05d}",
}


@pytest.mark.parametrize("rule", ONE_NUMBER)
def test_one_number_changes(rule):
    names = [ONE_NUMBER[rule].format(frame) for frame in reversed(FRAMES)]
    found = frame_numbers(names, "here")
    assert found.numbers == tuple(reversed(FRAMES)) and not found.notes and not found.cameras
    assert list(found.by_number(names)) == FRAMES


def test_a_prefix_never_ends_within_a_number():
    """All of 0010 … 0019 begin with 001."""
    assert frame_numbers([f"{frame:04d}" for frame in range(10, 20)], "here").numbers == tuple(range(10, 20))


@pytest.mark.parametrize(
    "rule", ["{0:05d}_{1:02d}", "{1:02d}_{0:05d}", "cam{1}_{0:03d}", "{0:04d}_view{1}", "2024_{0:05d}_{1:02d}_512"]
)
def test_frame_and_camera(rule):
    names = [rule.format(frame, camera) for camera in (0, 1, 2) for frame in FRAMES]
    first = frame_numbers(names, "here")
    assert first.numbers == (*FRAMES, *[None] * 12) and first.cameras == (0, 1, 2)
    assert "of cameras 0, 1, 2, camera 0 is used; choose another one with --camera" in first.notes[0]
    second = frame_numbers(names, "here", camera=1)
    assert second.numbers == (*[None] * 6, *FRAMES, *[None] * 6) and "camera 1 is used" in second.notes[0]
    with pytest.raises(InputError, match="here: no camera 7 in the names, only 0, 1, 2"):
        frame_numbers(names, "here", camera=7)


def test_as_many_cameras_as_frames():
    names = [f"{frame:05d}_{camera:02d}" for frame in range(3) for camera in range(3)]
    assert frame_numbers(names, "here").numbers == (0, None, None, 1, None, None, 2, None, None)


def test_a_word_tells_the_camera_where_it_has_more_values():
    names = [f"cam{camera:02d}_{frame}" for frame in range(2) for camera in range(16)]
    found = frame_numbers(names, "here", camera=5)
    assert found.by_number(names) == {0: "cam05_0", 1: "cam05_1"}


def test_a_time_stamp_belongs_to_the_frame():
    names = [f"img_{frame:04d}_{1_700_000_000_123 + 33 * frame}" for frame in range(5)]
    assert frame_numbers(names, "here").numbers == (0, 1, 2, 3, 4)
    names = [f"{frame:04d}_{33 * frame:06d}" for frame in range(5)]
    assert frame_numbers(names, "here").numbers == (0, 1, 2, 3, 4)


def test_single_names():
    assert frame_numbers(["00012_03"], "here").numbers == (12,)
    assert frame_numbers(["take2_0007"], "here").numbers == (7,)


def test_other_names_are_left_out_or_refused():
    names = [*(f"{frame:05d}" for frame in range(30)), "thumbnail_1", "cover"]
    found = frame_numbers(names, "here")
    assert found.numbers == (*range(30), None, None)
    assert found.notes == ("1 names of another kind are left out, such as thumbnail_1",)
    both = [f"{frame:05d}_{kind}" for frame in range(4) for kind in ("rgb", "mask")]
    with pytest.raises(InputError, match=r"here: .*names of one kind, found 00000_rgb and 00000_mask; move one kind"):
        frame_numbers(both, "here")
    assert frame_numbers(["left", "right"], "here").numbers == (None, None)
    assert frame_numbers([], "here").numbers == ()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["007", "7", "8"], "one image per frame, found 007 and 7 for frame 7; remove one"),
        (["1700000000123456", "1700000000156789"], "at most 9 digits"),
        ([f"12-{m}-{s}" for m in (0, 1) for s in (0, 30)], None),
        ([f"{h}-{m}-{s}" for h in (1, 2) for m in (0, 1) for s in (0, 30)], "found 3 in 1-0-0"),
    ],
)
def test_refused(names, message):
    if message is None:
        assert frame_numbers(names, "here").cameras, "two numbers that change are frame and camera"
        return
    with pytest.raises(InputError, match=message):
        frame_numbers(names, "here")
