"""The page on another screen: the address under which others reach it, and that address as a QR code."""

from __future__ import annotations

import io
import ipaddress
import socket

import segno
from markupsafe import Markup

from highside.config.web import WebTable

BORDER = 3
"""Quiet modules round the code; the paper round it has the rest of the four that scanners wish."""
_ELSEWHERE = {socket.AF_INET: "192.0.2.1", socket.AF_INET6: "2001:db8::1"}
"""Addresses of nobody (RFC 5737, RFC 3849): the way to them is the way to others, and nothing is sent there."""


def reachable_host(settings: WebTable) -> str | None:
    """This machine as others name it in an address; None where the page listens for this machine alone."""
    if settings.is_loopback:
        return None
    try:
        address = ipaddress.ip_address(settings.host)
    except ValueError:
        return settings.host
    if not address.is_unspecified:
        return _in_url(settings.host)
    families = (socket.AF_INET,) if address.version == 4 else (socket.AF_INET6, socket.AF_INET)
    found = next((own for family in families if (own := _own_address(family)) is not None), None)
    return socket.gethostname() if found is None else _in_url(found)


def _own_address(family: socket.AddressFamily) -> str | None:
    """The address that this machine would speak to others from; None where it has no way to them."""
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as unsent:
            unsent.connect((_ELSEWHERE[family], 9))
            own = str(unsent.getsockname()[0])
    except OSError:
        return None
    return None if ipaddress.ip_address(own).is_loopback else own


def _in_url(address: str) -> str:
    return f"[{address}]" if ":" in address else address


def qr_svg(link: str) -> Markup:
    """The link as an SVG of black on white, whatever the page's colours; scanners need it so."""
    # modules alone: no letter of the link is in it
    return Markup(segno.make_qr(link, error="m").svg_inline(border=BORDER, scale=6, light="#fff", omitsize=True))


def qr_text(link: str) -> str:
    """The link for a terminal, two modules a letter high."""
    out = io.StringIO()
    segno.make_qr(link, error="l").terminal(out, border=2, compact=True)
    return out.getvalue()
