"""What stands at the head of a certificate beside words: the laboratory's logo, and a QR code that says what it is.

The code holds a short text: number, record and its hash, and by which key the record was signed; or, where the
laboratory lets certificates be verified at an address, that address with the record's id. It is no proof by itself: the
record is checked by `highside keys verify`, and the file by its detached signature.
"""

from __future__ import annotations

import base64

from markupsafe import Markup

from highside.errors import InputError
from highside.printable import printable
from highside.reading import read_named
from highside.report.certificate_inputs import Inputs
from highside.words import _

LOGO_MAX = 1_000_000
_KINDS = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))


def verification(inputs: Inputs, named: str) -> str:
    """What the code says, in the certificate's language."""
    record, url = inputs.record, inputs.fields.issue.verify_url
    if url is not None:
        return f"{url}{record.id}"
    lines = [
        _("Calibration certificate %(number)s", number=named),
        _("tool %(tool)s", tool=printable(record.tool_id)),
        _("record SHA-256 %(id)s", id=record.id),
    ]
    if record.signature is not None:
        lines.append(_("signed ed25519 %(key)s", key=record.signature.key))
    return "\n".join(lines)


def qr_code(text: str) -> Markup | None:
    """The code as SVG; None where what draws it is not installed."""
    try:
        import segno
    except ImportError:
        return None
    drawn = segno.make(text, error="m", micro=False).svg_inline(scale=1, border=4, omitsize=True)
    # drawn from the text as squares: no word of it stands in the picture
    return Markup(drawn)


def logo_of(inputs: Inputs) -> str | None:
    """The logo as a `data:` address. Raises InputError for a file that is no small PNG or JPEG."""
    path = inputs.fields.issue.logo
    if path is None:
        return None
    data = read_named(path, "issue.logo", max_bytes=LOGO_MAX)
    kind = next((kind for mark, kind in _KINDS if data.startswith(mark)), None)
    if kind is None:
        raise InputError("is neither PNG nor JPEG", where=str(path), field="issue.logo", remedy="convert the logo")
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
