"""Keyword options of the public functions, checked as the commands check their flags."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from ggavatar.errors import InputError, nearest

_NUMBERS = {int: (int, np.integer), float: (int, float, np.integer, np.floating)}


def check_options(function: str, given: Mapping[str, Any], options: type) -> None:
    """Check names, types and choices of keyword arguments.

    Args:
        function: Name of the function, for messages.
        given: Its keyword arguments.
        options: A `TypedDict` of what they may be.

    Raises:
        TypeError: An argument is not known, and the message has the nearest name; or its type is another.
        InputError: A value is none of the choices.
    """
    hints = typing.get_type_hints(options)
    for name, value in given.items():
        if name not in hints:
            suggestion = nearest(name, list(hints))
            raise TypeError(f"{function}() got an unexpected keyword argument {name!r}{suggestion}")
        check_value(f"{function}({name}=…)", value, hints[name])


def check_value(where: str, value: Any, hint: Any) -> None:
    """Check one value against its annotation; `where` begins the message. Raises as `check_options` does."""
    if typing.get_origin(hint) is Literal:
        choices = typing.get_args(hint)
        if value not in choices:
            close = nearest(value, choices) if isinstance(value, str) else ""
            raise InputError(f"{where}: expected one of {', '.join(choices)}, found {value!r}{close}")
        return
    wanted = _NUMBERS.get(hint, typing.get_origin(hint) or hint)
    is_text_for_several = isinstance(value, str) and typing.get_origin(hint) is not None
    is_truth_for_number = isinstance(value, bool) and hint in _NUMBERS
    if not isinstance(value, wanted) or is_text_for_several or is_truth_for_number:
        name = getattr(hint, "__name__", str(hint))
        raise TypeError(f"{where}: expected {name}, found {type(value).__name__}")
