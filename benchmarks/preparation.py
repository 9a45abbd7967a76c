"""Speed of `ggavatar-prep` by stage, and its memory on long videos."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.ordered_map import cores
from preprocess.pipeline.pipeline import STAGES

CLIP = "talk_450.mp4"
"""Clip in $GGAVATAR_TEST_DATA/clips to prepare; long videos repeat it forward and backward."""
QUICK_FRAMES, QUICK_LENGTHS = 60, (60, 120)
LENGTHS = (500, 1000, 2000)
"""Lengths of the videos for the memory measurement, frames; $GGAVATAR_LONG_FRAMES adds one (7500 are 5 minutes)."""
LONG_FRAMES = "GGAVATAR_LONG_FRAMES"
WIDTH, HEIGHT, RATE = 1920, 1080, 25
GOAL_STAGES = ("masks", "tracking")
"""Masks, landmarks and pose, the stages of the goal of 15 frames per second; tracking also builds the head."""
SAMPLE_SECONDS = 0.1
COMMAND = "import sys; from preprocess.cli.prep import main; sys.exit(main(sys.argv[1:]))"


def clip_path() -> Path:
    """Path of the clip; `InputError` without the test data."""
    folder = os.environ.get("GGAVATAR_TEST_DATA")
    path = Path(folder or ".") / "clips" / CLIP
    if not folder or not path.is_file():
        raise InputError(f"{path}: no such file; set GGAVATAR_TEST_DATA to the folder that holds clips/{CLIP}")
    return path


def prepare(video: Path, folder: Path, frames: int | None = None) -> dict[str, Any]:
    """Run the command in a process: number of frames, seconds by stage, and peak memory of its processes, MiB."""
    subset = ["--frames", f":{frames}"] if frames else []
    command = [sys.executable, "-c", COMMAND, str(video), "-o", str(folder), "--offline", *subset]
    began = time.perf_counter()
    with (folder.parent / "stderr.txt").open("w+", encoding="utf-8") as stderr:
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stderr) as process:
            peak = peak_megabytes(process)
        seconds = time.perf_counter() - began
        stderr.seek(0)
        text = stderr.read()
    if process.returncode:
        raise RuntimeError(f"ggavatar-prep {video} failed: {text}")
    stages = stage_seconds(text)
    return {"frames": stages.pop("count"), "seconds": round(seconds, 2), "stages": stages, "peak_mb": peak}


def stage_seconds(text: str) -> dict[str, Any]:
    """Seconds by stage name, and the number of frames, parsed from the command's output."""
    found: dict[str, Any] = {"count": 0}
    for stage in STAGES:
        line = re.search(rf"^{re.escape(stage.title)}: (?:(\d+) )?([\d.]+) s$", text, re.MULTILINE)
        if line is None:
            raise RuntimeError(f"expected the seconds of {stage.title!r} in the output of ggavatar-prep, found: {text}")
        found[stage.name] = float(line[2])
        found["count"] = max(found["count"], int(line[1] or 0))
    return found


def peak_megabytes(process: subprocess.Popen[bytes]) -> float | None:
    """Wait for a process; return the peak memory of it and its descendants together, MiB."""
    if not Path("/proc/self/status").exists():
        process.wait()
        return None
    peak = 0.0
    while process.poll() is None:
        peak = max(peak, sum(resident_megabytes(each) for each in process_tree(process.pid)))
        time.sleep(SAMPLE_SECONDS)
    return round(peak, 1)


def process_tree(pid: int) -> Iterator[int]:
    """Ids of a process and its descendants."""
    yield pid
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()
    except OSError:
        return
    for child in children:
        yield from process_tree(int(child))


def resident_megabytes(pid: int) -> float:
    """Peak resident memory of a process so far, MiB; 0 once it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    line = re.search(r"^VmHWM:\s+(\d+)", status, re.MULTILINE)
    return int(line[1]) / 1024 if line else 0.0


def wide_frames(clip: Path, count: int) -> Iterator[np.ndarray]:
    """The clip's first frames, forward and backward, RGB, centered in a wide image."""
    with av.open(str(clip)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in islice(container.decode(video=0), count)]
    side = (WIDTH - HEIGHT) // 2
    for frame in [*frames, *frames[::-1]]:
        square = cv2.resize(frame, (HEIGHT, HEIGHT), interpolation=cv2.INTER_CUBIC)
        yield cv2.copyMakeBorder(square, 0, 0, side, side, cv2.BORDER_REFLECT_101)


def encode(frames: Iterator[np.ndarray], path: Path) -> None:
    """Write H.264 without B-frames, so that the video can be repeated packet by packet."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=RATE, options={"preset": "ultrafast", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))


def repeat(short: Path, path: Path, count: int) -> None:
    """Write a video of `count` frames that repeats a short one without re-encoding."""
    with av.open(str(short)) as source, av.open(str(path), "w") as target:
        given = source.streams.video[0]
        stream = target.add_stream_from_template(given)
        packets = [(bytes(packet), packet.is_keyframe) for packet in source.demux(given) if packet.size]
        step = round(1 / (RATE * given.time_base))
        for number, (content, key) in enumerate(islice(cycle(packets), count)):
            packet: Any = av.Packet(content)
            packet.stream, packet.time_base, packet.is_keyframe = stream, given.time_base, key
            packet.pts = packet.dts = number * step
            target.mux(packet)


def memory(clip: Path, folder: Path, lengths: tuple[int, ...], own: int) -> dict[str, Any]:
    """Figures for preparing 1080p videos of several lengths."""
    short, found = folder / "short.mp4", {}
    encode(wide_frames(clip, own), short)
    for length in lengths:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            video = Path(place) / "video.mp4"
            repeat(short, video, length)
            found[str(length)] = with_rates(prepare(video, Path(place) / "capture"))
    return found


def with_rates(run: dict[str, Any]) -> dict[str, Any]:
    """The figures of a run with frames per second: of the whole command, and of masks, landmarks and pose alone."""
    goal_seconds = sum(run["stages"][name] for name in GOAL_STAGES)
    rates = {
        "frames_per_second": round(run["frames"] / run["seconds"], 2),
        "masks_landmarks_pose_frames_per_second": round(run["frames"] / goal_seconds, 2),
    }
    return run | rates


def run(options: argparse.Namespace) -> dict[str, object]:
    """Measure the clip at 512×512 px several times, and the memory for 1080p videos of several lengths."""
    clip, quick = clip_path(), options.quick
    extra = int(os.environ.get(LONG_FRAMES, "0"))
    lengths = (*(QUICK_LENGTHS if quick else LENGTHS), *([extra] if extra else []))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rounds = [
            with_rates(prepare(clip, folder / str(number), QUICK_FRAMES if quick else None))
            for number in range(options.repeats or (1 if quick else 3))
        ]
        long = memory(clip, folder, lengths, QUICK_FRAMES if quick else 500)
    speed = sorted(rounds, key=lambda each: each["seconds"])[len(rounds) // 2]
    return {"clip": CLIP, "size": 512, "cores": cores(), "median_round": speed, "rounds": rounds, "wide": long}
