"""A file of Gaussians in another format: what one program wrote, for another to open."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.formats.export import ExportResult, format_losses, splat_writer
from ggavatar.formats.gaussian_files import read_gaussians
from ggavatar.formats.output_folder import check_output_file, output_file
from ggavatar.formats.source_options import GaussianReadingOptions


def convert(
    source: Path, options: GaussianReadingOptions, kind: str, path: Path, overwrite: bool = False
) -> ExportResult:
    """Read a file of Gaussians and write it in another format.

    Args:
        source: Any file that `read_gaussians` opens.
        options: How its numbers are meant.
        kind: One of `ggavatar.formats.splat_formats.splat_formats`.
        path: The file to write.
        overwrite: Replace an existing file.

    Raises:
        InputError: The source cannot be read, is bound to a head and the format cannot say so, or the output exists
            and must not be replaced.
    """
    if path.exists() and path.samefile(source):
        raise InputError(f"{path}: expected another file than the source; choose one with -o")
    check_output_file(path, overwrite)
    write = splat_writer(kind)
    rows = read_gaussians(source, options)
    if rows.faces is not None and kind != "ply":
        raise InputError(
            f"{source}: expected Gaussians in space for --format {kind}, found some bound to the triangles of a head "
            "(binding_0); only --format ply keeps the binding"
        )
    with output_file(path, overwrite):
        write(path, rows)
    return ExportResult(path, len(rows), (*rows.notes, *format_losses(kind, rows)))
