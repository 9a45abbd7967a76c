"""The report page: complete, bounded, self-contained, and interactive in a real browser if one is installed."""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from evaluate.cli.evaluate import main
from evaluate.figures.curves import curves, write_curves
from evaluate.figures.evaluation_images import EvaluationImages, display_names, worst_frames
from evaluate.figures.report import report_data, write_report
from evaluate.figures.report_images import report_images
from evaluate.figures.worst_frames import worst_frames_sheet
from evaluate.figures.write import write_comparisons, write_figures
from evaluate.protocols.protocol import protocol_by_name
from evaluate.protocols.results import Evaluation, write_results
from evaluate.scoring.frame_files import frame_file
from ggavatar.errors import InputError
from ggavatar.io.images import read_rgb, write_png
from tests.support.browser import chromium, opened

FRAMES = tuple(range(0, 240, 20))
HOSTILE = "</script><img src=http://evil.example/x onerror=alert(1)>"


class Page(HTMLParser):
    """The references of a page and the text of its data."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.tags: list[str] = []
        self.data = ""
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for key, value in attrs if key in ("src", "href", "action", "srcset", "data")]
        self._inside = tag == "script" and ("id", "data") in attrs

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.data += data


def parsed(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def evaluated(folder: Path, method: str, level: int, subject: str = "toy", seed: int | None = None) -> EvaluationImages:
    """Frames of noise, with an error that grows toward the last frame; the first frame is identical."""
    random = np.random.default_rng(1)
    psnr: list[float | None] = []
    home = folder / f"{method.replace('/', '_')[:8]}-{level}"
    for index, frame in enumerate(FRAMES):
        truth = random.integers(60, 190, (48, 40, 3), dtype=np.uint8)
        offset = index * level
        write_png(frame_file(home / "ground_truth", frame), truth)
        write_png(frame_file(home / "predictions", frame), truth + np.uint8(offset))
        psnr.append(20 * math.log10(255 / offset) if offset else math.inf)
    protocol = protocol_by_name("folders").override(metrics=("psnr", "ssim"), table_metrics=("psnr", "ssim"))
    values = {"psnr": tuple(psnr), "ssim": (None,) * len(FRAMES)}
    evaluation = Evaluation(
        subject, method, protocol, FRAMES, values, seed, {"ssim": "not measured"}, {"ground_truth": "aa"}
    )
    write_results(evaluation, home)
    return EvaluationImages.in_folder(evaluation, home)


def test_the_page_refers_to_nothing_outside_itself(tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", [evaluated(tmp_path, HOSTILE, 3, subject=HOSTILE)])
    page, text = parsed(tmp_path / "report.html"), (tmp_path / "report.html").read_text()
    assert page.references == [] and not {"link", "iframe", "object", "base", "form"} & set(page.tags)
    assert page.tags.count("script") == 2, "a hostile name must not open another one"
    assert "default-src 'none'" in text and not re.search(r"@import|url\(|fetch\(|XMLHttp|WebSocket|import\(", text)
    assert set(re.findall(r"https?://[^\"' ]+", text.replace(HOSTILE, ""))) <= {
        "http://www.w3.org/2000/svg",
        "http://evil.example/x",
    }
    assert "<img src=http" not in text, "names are escaped"
    assert not re.search(r"\{\{|\{%|\{#", text), "the template is filled in"


def test_the_page_links_the_avatar_where_it_was_exported(tmp_path: Path) -> None:
    report = tmp_path / "run" / "eval" / "folders" / "report.html"
    report.parent.mkdir(parents=True)
    one = evaluated(tmp_path, "ours", 3)
    write_report(report, [one])
    assert parsed(report).references == []
    avatar = tmp_path / "run" / "exports" / "avatar.html"
    avatar.parent.mkdir()
    avatar.write_text("page")
    write_report(report, [one])
    [address] = parsed(report).references
    assert (report.parent / address).resolve() == avatar.resolve()


def test_the_page_holds_numbers_images_and_protocol(tmp_path: Path) -> None:
    one = evaluated(tmp_path, "ours", 3)
    write_report(tmp_path / "report.html", [one, evaluated(tmp_path, "theirs", 5)])
    page, text = parsed(tmp_path / "report.html"), (tmp_path / "report.html").read_text()
    data = json.loads(page.data)
    assert data["methods"] == ["ours", "theirs"] and data["frames"] == list(FRAMES)
    assert data["values"]["psnr"][0][0] == "identical" and [m["name"] for m in data["metrics"]] == ["psnr"]
    assert data["values"]["psnr"][1][4] == pytest.approx(20 * math.log10(255 / 20))
    assert [entry["frame"] for entry in data["images"]] == list(FRAMES) and data["worst"][0] == FRAMES[-1]
    encoded = base64.b64decode(data["images"][4]["predictions"][0].partition(",")[2])
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert image.shape == (48, 40, 3)
    assert np.abs(image.mean() - read_rgb(frame_file(one.predictions, FRAMES[4])).mean()) < 2
    for words in (one.evaluation.protocol.digest, "Wang et al.", "gg-table", "not measured"):
        assert words in text


def test_a_small_budget_keeps_the_worst_and_an_even_choice(tmp_path: Path) -> None:
    one = evaluated(tmp_path, "ours", 3)
    whole, limit = report_images([one], 100.0)
    size = sum(len(entry["truth"]) + len(entry["predictions"][0]) + len(entry["errors"][0]) for entry in whole)
    part, _ = report_images([one], size / 1e6 * 0.7)
    frames = [entry["frame"] for entry in part]
    assert len(whole) == len(FRAMES) and 6 < len(frames) < len(FRAMES) and limit > 0
    assert frames == sorted(frames) and set(FRAMES[-6:]) <= set(frames) and FRAMES[0] in frames
    assert len(report_images([one], 0.0)[0]) == 1
    assert len(report_data([one], 0.0)["values"]["psnr"][0]) == len(FRAMES), "numbers of all frames are kept"


def test_reports_do_not_mix_subjects_or_protocols(tmp_path: Path) -> None:
    one = evaluated(tmp_path, "ours", 3)
    other = dataclasses.replace(one, evaluation=dataclasses.replace(one.evaluation, subject="another"))
    with pytest.raises(InputError, match="one subject under one protocol"):
        write_report(tmp_path / "report.html", [one, other])
    with pytest.raises(InputError, match="at least one"):
        write_report(tmp_path / "report.html", [])
    frame_file(one.truth, 40).unlink()
    with pytest.raises(InputError, match="image of frame 40"):
        write_report(tmp_path / "report.html", [one])
    assert not (tmp_path / "report.html").exists()


def test_labels_are_distinct_and_worst_frames_ordered(tmp_path: Path) -> None:
    one, two = evaluated(tmp_path, "ours", 3, seed=1), evaluated(tmp_path, "ours", 4, seed=2)
    assert display_names([one, two]) == ["ours (seed 1)", "ours (seed 2)"]
    assert display_names([one, one])[1].endswith("#2")
    assert worst_frames([one], 3) == [220, 200, 180] and worst_frames([one], 99)[-1] == 0
    assert worst_frames([one], 3, "ssim") == []


def test_curves_and_worst_sheet(tmp_path: Path) -> None:
    one, two = evaluated(tmp_path, "ours", 3), evaluated(tmp_path, "theirs", 5)
    (panel,) = curves([one, two]).axes
    assert panel.get_ylabel() == "PSNR, dB ↑" and [text.get_text() for text in panel.texts] == ["220", "220"]
    drawn = panel.lines[0].get_ydata()
    assert np.isnan(drawn[0]) and drawn[1] == one.evaluation.values["psnr"][1]
    write_curves(tmp_path / "curves.png", [one, two])
    assert read_rgb(tmp_path / "curves.png").shape[1] > 1000
    assert worst_frames_sheet(one, count=3, width=64).shape[1] > 3 * 64


def test_identical_and_unmeasured_frames_can_be_drawn(tmp_path: Path) -> None:
    one = evaluated(tmp_path, "ours", 0)
    assert all(value == math.inf for value in one.evaluation.values["psnr"])
    files = write_figures(one, one.predictions.parent)
    assert len(files) == 5
    nothing = dataclasses.replace(one.evaluation, values={"psnr": (None,) * len(FRAMES)})
    unmeasured = dataclasses.replace(one, evaluation=nothing)
    for path in files:
        path.unlink()
    assert [path.name for path in write_figures(unmeasured, one.predictions.parent)] == [
        "report.html", "comparison.png", "side_by_side.mp4",
    ]  # fmt: skip


def test_figures_are_written_once(tmp_path: Path) -> None:
    one = evaluated(tmp_path, "ours", 3)
    home = one.predictions.parent
    files = write_figures(one, home)
    assert [path.name for path in files] == [
        "report.html",
        "comparison.png",
        "side_by_side.mp4",
        "curves.png",
        "worst.png",
    ]
    times = [path.stat().st_mtime_ns for path in files]
    assert [path.stat().st_mtime_ns for path in write_figures(one, home)] == times
    other, second_subject = evaluated(tmp_path, "theirs", 5), evaluated(tmp_path, "ours", 4, subject="b/c")
    study = write_comparisons([one, other, second_subject], tmp_path)
    assert [path.name for path in study] == ["comparison-toy.png", "report-toy.html"]
    gallery = write_comparisons([one, second_subject], tmp_path)
    assert [path.name for path in gallery] == ["comparison.png"]
    assert write_comparisons([one], tmp_path) == write_comparisons([], tmp_path) == []


@pytest.mark.slow
def test_the_page_is_interactive_in_a_browser(tmp_path: Path) -> None:
    browser = chromium()
    if browser is None:
        pytest.skip("needs Chromium or Chrome on the path")
    write_report(tmp_path / "report.html", [evaluated(tmp_path, "ours", 3)])
    with opened(browser, tmp_path / "report.html", tmp_path / "profile") as page:
        label = "document.getElementById('frame-label').textContent"
        assert page.value(label) == "frame 0"
        assert page.value("document.getElementById('image-right').naturalWidth") == 40, "the image is shown"
        assert page.value("document.querySelectorAll('#chart path').length") == 1, "the curve is drawn"
        page.drag("#stage", 0.5, 0.25)
        assert page.value("state.split") == pytest.approx(25, abs=1)
        assert page.value("document.getElementById('image-left').style.clipPath").startswith("inset(0px 75")
        page.drag("#scrubber", 0.02, 0.98)
        assert page.value(label) == f"frame {FRAMES[-1]}"
        assert page.value("document.getElementById('image-right').alt") == f"ours, frame {FRAMES[-1]}"
        assert "17.76 dB" in page.value("document.getElementById('now').textContent")
        page.drag("#chart", 0.5, 0.06)
        assert page.value(label) == "frame 0"
        page.drag("#worst button", 0.5, 0.5)
        assert page.value(label) == "frame 220"
        page.drag("#previous", 0.5, 0.5)
        assert page.value(label) == "frame 200"
        requested = [e["params"]["request"]["url"] for e in page.events if e["method"] == "Network.requestWillBeSent"]
        assert [url for url in requested if not url.startswith("data:")] == [(tmp_path / "report.html").as_uri()]
        assert not [event for event in page.events if event["method"] == "Runtime.exceptionThrown"]


def test_the_command_draws_unless_told_not_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = evaluated(tmp_path, "ours", 3)
    folders = ["--pred", str(one.predictions), "--gt", str(one.truth), "--no-lpips"]
    assert main([*folders, "-o", str(tmp_path / "with")]) == 0
    assert str(tmp_path / "with" / "report.html") in capsys.readouterr().out.replace("\n", "")
    assert (tmp_path / "with" / "side_by_side.mp4").is_file()
    assert main([*folders, "-o", str(tmp_path / "without"), "--no-report"]) == 0
    assert not (tmp_path / "without" / "report.html").exists()
