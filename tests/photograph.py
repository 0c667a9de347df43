"""A photograph as a phone gives it: lying on its side, with the place where it was taken in it."""

from __future__ import annotations

import io

from PIL import Image

ORIENTATION, GPS, LATITUDE = 0x0112, 0x8825, 2
TURNED = 6
"""The camera was held upright: to be turned by 90 deg."""


def a_photograph(width: int = 400, height: int = 300, kind: str = "JPEG") -> bytes:
    """`width`, `height` as the sensor reads them out; shown they are exchanged."""
    picture = Image.linear_gradient("L").resize((width, height)).convert("RGB")
    exif = Image.Exif()
    exif[ORIENTATION] = TURNED
    exif.get_ifd(GPS)[LATITUDE] = (52.0, 31.0, 0.0)
    out = io.BytesIO()
    picture.save(out, kind, exif=exif)
    return out.getvalue()
