"""Types of the public API, for type checkers and editors; `__init__.py` imports each name when it is first used."""

from evaluate.api.scores import list_metrics as list_metrics
from evaluate.api.scores import read_scores as read_scores
from evaluate.api.scores import score_folders as score_folders
from evaluate.api.scores import score_pictures as score_pictures
from evaluate.api.scores import score_run as score_run
from evaluate.api.tables import make_tables as make_tables
from evaluate.api.tables import write_tables as write_tables
from evaluate.api.tables import write_video as write_video
from evaluate.metrics.metric import Metric as Metric
from evaluate.protocols.results import Evaluation as Evaluation
from evaluate.tables.table import Table as Table
from ggavatar.api.exporting import export as export
from ggavatar.api.images import render_frames as render_frames
from ggavatar.api.images import render_performance as render_performance
from ggavatar.api.performances import Performance as Performance
from ggavatar.api.performances import drive as drive
from ggavatar.api.runs import list_methods as list_methods
from ggavatar.api.runs import open_capture as open_capture
from ggavatar.api.runs import open_run as open_run
from ggavatar.api.runs import train as train
from ggavatar.core import Camera as Camera
from ggavatar.core import Drive as Drive
from ggavatar.core import Gaussians as Gaussians
from ggavatar.data.capture import Capture as Capture
from ggavatar.errors import InputError as InputError
from ggavatar.formats.export import ExportResult as ExportResult
from ggavatar.training.run_folder import Run as Run
from preprocess.api.captures import check_capture as check_capture
from preprocess.api.captures import list_importers as list_importers
from preprocess.api.captures import make_demo as make_demo
from preprocess.api.captures import prepare_capture as prepare_capture
from preprocess.doctor.diagnosis import Diagnosis as Diagnosis

__version__: str
__all__: list[str]
