"""Expected shapes of arrays in head-model files; None in a shape stands for any size."""

from __future__ import annotations


def shape_fits(shape: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    """Whether a shape has the expected number of dimensions and sizes."""
    return len(shape) == len(expected) and all(
        want is None or want == size for size, want in zip(shape, expected, strict=True)
    )


def describe_shape(expected: tuple[int | None, ...]) -> str:
    """An expected shape for messages, such as `[5023, 3, any]`."""
    return "[" + ", ".join("any" if size is None else str(size) for size in expected) + "]"
