"""What the user can do when the computer has no more memory, space or open files: only flags that the command has."""

from __future__ import annotations

import errno
from collections.abc import Collection, Sequence

FILES = "Too many open files: raise the limit (ulimit -n)."
FEWER = (
    ("--frames", "fewer frames (--frames)"),
    ("--size", "smaller frames (--size)"),
    ("--width", "smaller pictures (--width)"),
    ("--max-gaussians", "fewer Gaussians (--max-gaussians)"),
    ("--threads", "fewer threads (--threads)"),
    ("", "a computer with more memory"),
)
"""What needs less memory, each with the flag that it needs."""
ON_DEVICE = (
    ("--max-gaussians", "fewer Gaussians (--max-gaussians)"),
    ("--set", "the perceptual loss on crops (--set perceptual_mode=crops)"),
    ("--width", "smaller pictures (--width)"),
    ("--device", "another device (--device cuda:1, --device cpu)"),
    ("", "a capture of smaller frames (ggavatar-prep --size)"),
)
"""What needs less memory of a GPU."""


def exhausted(error: Exception, flags: Collection[str]) -> tuple[str, str] | None:
    """Kind and message if an error says that the machine has no more memory, threads or open files; else None.

    Args:
        error: What was raised.
        flags: Those of the command.
    """
    text = str(error).splitlines()[0] if str(error) else ""
    if "Too many open files" in text:
        return "error", FILES
    if type(error).__name__ == "OutOfMemoryError":  # torch's, which need not be imported here
        return "out of memory", f"{text} {less_memory(flags, on_device='CUDA' in text)}"
    lacking = ("can't allocate memory", "cannot allocate memory", "failed to map segment", "can't start new thread")
    if any(words in str(error).lower() for words in lacking):
        return "out of memory", f"{text}; raise the limit (ulimit -v). {less_memory(flags)}"
    return None


def less_memory(flags: Collection[str], on_device: bool = False) -> str:
    """A sentence on what needs less memory; checkpoints of a training stay in any case."""
    kept = " Checkpoints are intact." if "--save-every" in flags else ""
    return f"Use {_either([text for flag, text in (ON_DEVICE if on_device else FEWER) if flag in ('', *flags)])}.{kept}"


def next_step(code: int | None, flags: Collection[str]) -> str:
    """What the user can do about an error of the operating system."""
    elsewhere = " or choose another folder with -o" if "-o" in flags else ""
    steps = {
        errno.ENOSPC: f"; free some space{elsewhere}, then run the same command again",
        errno.EACCES: f"; check the permissions{elsewhere}",
        errno.EROFS: "; choose a writable folder with -o" if "-o" in flags else "; make the folder writable",
        errno.EMFILE: "; raise the limit (ulimit -n)",
    }
    return steps.get(code or 0, "")


def _either(texts: Sequence[str]) -> str:
    """Texts as alternatives."""
    return " or ".join((", ".join(texts[:-1]), texts[-1])) if len(texts) > 1 else texts[0]
