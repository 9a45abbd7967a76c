"""The address of the viewer: this computer alone unless its user says otherwise, and only pages that it serves."""

from __future__ import annotations

import socket
from urllib.parse import urlsplit

from ggavatar.errors import InputError

THIS_COMPUTER, EVERYWHERE = "127.0.0.1", "0.0.0.0"
PORTS_TRIED = 50
"""How many ports are tried after one that is in use."""
OWN_NAMES = ("127.0.0.1", "localhost", "::1")
"""Names under which a browser on this computer, or at the end of a tunnel to it, knows this computer."""


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that can be listened on; 0 is any.

    Raises:
        InputError: None of `PORTS_TRIED` ports can be had.
    """
    last = min(port + PORTS_TRIED, 65536) if port else 1
    reason = "all are in use"
    for candidate in range(port, last):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            try:
                probe.bind((host, candidate))
            except OSError as error:
                reason = error.strerror or str(error)
                continue
            return int(probe.getsockname()[1])
    raise InputError(
        f"expected a free port from {port} to {last - 1} on {host}, found none ({reason}); choose another with --port, "
        "or --port 0 for any"
    )


def is_own_page(origin: str | None, host: str | None, is_public: bool) -> bool:
    """Whether a connection comes from a page that this server has served, or from a program that is no browser.

    A browser sends the origin of the page that opens a connection. Other sites' pages may not watch or drive what is
    shown, nor may a site whose name has come to lead to this computer (DNS rebinding).

    Args:
        origin: The header `Origin`; None if there is none.
        host: The header `Host`.
        is_public: Whether other names than those of this computer are expected.
    """
    if origin is None:
        return True
    try:
        name, asked = urlsplit(origin), urlsplit(f"//{host or ''}")
        return name.netloc == asked.netloc and (is_public or asked.hostname in OWN_NAMES)
    except ValueError:
        return False
