"""The last stage: the doctor examines the capture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ggavatar.data.capture import Capture
from preprocess.doctor.diagnosis import PREVIEW, REPORT, examine, plain_values, write_report
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Stage, StageContext


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """Nothing but the results of the earlier stages."""
    return {}


def run(context: StageContext) -> Mapping[str, Any]:
    """Examine the new capture; write doctor.json and preview.jpg."""
    from ggavatar.head.files import load_head
    from preprocess.doctor.preview import write_preview

    capture = Capture.open(context.folder)
    head = load_head(capture.head_path)
    diagnosis = examine(capture, head)
    write_report(capture, diagnosis)
    write_preview(capture, head)
    context.reporter.advance(1, 1)
    return plain_values(diagnosis.json())


STAGE = Stage("doctor", "Examining", inputs, run, outputs=(REPORT, PREVIEW), version=2)
