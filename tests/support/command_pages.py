"""The pages of all commands."""

from __future__ import annotations

from evaluate import options as evaluation
from evaluate.rendering import options as rendering
from evaluate.viewer import options as viewer
from ggavatar.cli import export, models, sweep, train
from ggavatar.cli.page import CommandPage
from preprocess.cli import demo, doctor, prep

PAGES: dict[str, CommandPage] = {
    module.PAGE.program: module.PAGE
    for module in (demo, prep, doctor, train, sweep, rendering, evaluation, export, viewer, models)
}
