"""Lines on a terminal or in a log: what they quote can neither steer the terminal nor forge another line.

Every message of every command leaves through `write_out` or `write_err`, but for those on the compilation of kernels.
"""

from __future__ import annotations

import re
import sys

from ggavatar.text.names import INVISIBLE, NOT_TEXT

_BREAKS = re.compile(r"[\t\r\n\v\f\x1c-\x1e\x85\u2028\u2029]+ *")
_OBEYED = re.compile(f"{NOT_TEXT.pattern}|{INVISIBLE.pattern}")
_LEADING_COMMAND = re.compile(r"^(\s*:)(?=:)")
_INNER_COMMAND = re.compile(r"##(?=\[|vso\[|teamcity\[)")


def printable(text: str) -> str:
    r"""The text on one line, with characters that a terminal would obey written as `\x1b` or `\u202e`.

    Those are what is `NOT_TEXT` or `INVISIBLE`. Line breaks and tabs become a space. CI servers read commands from the
    log (`::error::` at the start of a line, `##[error]` anywhere): a space takes them apart.
    """
    text = _OBEYED.sub(_escape, _BREAKS.sub(" ", text))
    return _INNER_COMMAND.sub("# #", _LEADING_COMMAND.sub(r"\1 ", text))


def write_out(*lines: str) -> None:
    """Write lines to the standard output, each made `printable`."""
    sys.stdout.write("".join(f"{printable(line)}\n" for line in lines))


def write_err(*lines: str) -> None:
    """Write lines to the standard error output, each made `printable`."""
    sys.stderr.write("".join(f"{printable(line)}\n" for line in lines))


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
