"""What a pretended device counts: kernel launches, and where the host would have waited for the device."""

from __future__ import annotations

import functools
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

OURS = ("ggavatar", "evaluate", "preprocess")
"""Packages whose lines are named as the place of a synchronization."""
ROOT = Path(__file__).resolve().parents[2]

NO_LAUNCH = frozenset(
    """_reshape_alias _unsafe_view alias as_strided chunk detach device diagonal empty empty_like empty_permuted
    empty_strided expand is_same_size lift lift_fresh movedim new_empty new_empty_strided numpy_T permute real reshape
    resize_ select set_ slice split split_with_sizes squeeze t transpose unbind unfold unsafe_split unsqueeze view
    view_as_real""".split()  # noqa: SIM905 - a list of one name a line would fill a page
)
"""Operations that only describe memory."""

SEVERAL_LAUNCHES = {
    "_foreach_norm": 2, "_index_put_impl_": 6, "argsort": 4, "index_put": 6, "index_put_": 6,
    "sort": 4, "topk": 4,
}  # fmt: skip
"""Launches of operations that need more than one on CUDA; accumulating `index_put` sorts its indices."""

WAITING = frozenset(
    """_linalg_check_errors _linalg_det _linalg_eigh _linalg_svd _unique2 bincount equal inverse is_nonzero
    linalg_inv_ex linalg_svd masked_select nonzero unique_consecutive unique_dim""".split()  # noqa: SIM905
)
"""Operations whose result decides a shape or a branch on the host, so that it waits for the device."""


@dataclass
class Tally:
    """Counts since the last `reset`.

    Attributes:
        launches: Kernels that the device would have been given.
        operations: How often each operation launched.
        syncs: How often the host would have waited, by what for and the line of ours that caused it.
    """

    launches: int = 0
    operations: Counter[str] = field(default_factory=Counter)
    syncs: Counter[tuple[str, str]] = field(default_factory=Counter)

    def reset(self) -> None:
        """Start counting at zero."""
        self.launches = 0
        self.operations, self.syncs = Counter(), Counter()

    def launch(self, name: str, count: int | None = None) -> None:
        """Count an operation on the device, as `count` launches or as many as it is known to need."""
        if name not in NO_LAUNCH:
            self.operations[name] += 1
            self.launches += SEVERAL_LAUNCHES.get(name, 1) if count is None else count

    def wait(self, reason: str) -> None:
        """Count a synchronization."""
        self.syncs[reason, place()] += 1

    def places(self) -> dict[str, int]:
        """Synchronizations by place and reason, most frequent first."""
        return {f"{where}: {reason}": count for (reason, where), count in self.syncs.most_common()}


def place() -> str:
    """The innermost line of our packages in the call stack, as `path:line function`."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        path = frame.f_code.co_filename
        if _is_ours(path):
            return f"{Path(path).relative_to(ROOT)}:{frame.f_lineno} {frame.f_code.co_name}"
        frame = frame.f_back
    return "outside our packages"


def is_in_formula() -> bool:
    """Whether an autograd formula of torch makes the current call, in C++, and not a line of ours.

    Formulas make zeros and copies with the options of their inputs, which are on the CPU for a pretended tensor.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        path = frame.f_code.co_filename
        if path.endswith(("autograd/graph.py", "autograd/__init__.py")):
            return True
        if _is_ours(path):
            return False
        frame = frame.f_back
    return False


def is_backward() -> bool:
    """Whether the innermost line of ours is in the backward pass of a function of ours."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and not _is_ours(frame.f_code.co_filename):
        frame = frame.f_back
    return frame is not None and "backward" in frame.f_code.co_name


@functools.cache
def _is_ours(path: str) -> bool:
    """Whether a source file belongs to one of our packages."""
    return Path(path).is_relative_to(ROOT) and Path(path).relative_to(ROOT).parts[0] in OURS
