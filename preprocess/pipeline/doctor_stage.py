"""The last stage: the doctor examines the capture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ggavatar.data.capture import Capture
from preprocess.doctor.diagnosis import PREVIEW, REPORT, examine, plain_values, write_report
from preprocess.doctor.mask_check import FRAMES
from preprocess.options import PrepOptions
from preprocess.pipeline.evidence_stage import faces_by_frame
from preprocess.pipeline.stage import Stage, StageContext
from preprocess.tracking.geometry.rigid import evenly_spaced


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """Nothing but the results of the earlier stages."""
    return {}


def run(context: StageContext) -> Mapping[str, Any]:
    """Examine the new capture; write doctor.json and preview.jpg."""
    from ggavatar.head.files import load_head
    from preprocess.doctor.preview import write_preview

    capture = Capture.open(context.folder)
    head = load_head(capture.head_path)
    diagnosis = examine(capture, head, _faces(context, capture))
    write_report(capture, diagnosis)
    write_preview(capture, head)
    context.reporter.advance(1, 1)
    return plain_values(diagnosis.json())


def _faces(context: StageContext, capture: Capture) -> dict[int, np.ndarray]:
    """The faces of some frames by row, as found before."""
    known = faces_by_frame(context)
    rows = [row for row, number in enumerate(capture.frames) if number in known]
    return {rows[place]: known[capture.frames[rows[place]]] for place in evenly_spaced(len(rows), FRAMES) if rows}


STAGE = Stage("doctor", "Examining", inputs, run, outputs=(REPORT, PREVIEW), version=4)
