"""What a reader wants to know of a calibration record, as plain values in degrees and g."""

from __future__ import annotations

from typing import Any

import numpy as np

from highside.calibration.record import CalibrationRecord

__all__ = ["SUMMARY_INCLINATIONS_DEG", "summary", "uncertainty"]

SUMMARY_INCLINATIONS_DEG = (0.6, 1.2, 3.0, 10.0, 30.0, 45.0, 60.0, 90.0)
"""inclinations at which the accuracy of a calibration is said, deg: from the steepest inclination of a bench to
horizontal"""


def summary(record: CalibrationRecord) -> dict[str, Any]:
    """What a reader wants to know of a record, as plain values; degrees and g."""
    result = record.result
    fit = result.poses
    used = fit.used
    worst = int(np.argmax(np.abs(fit.studentised))) if fit.studentised.size else 0
    tilt = result.tilt_rad
    return {
        "id": record.id,
        "tool": record.tool_id,
        "serial": record.serial,
        "method": result.method,
        "options": dict(result.options),
        "frame": result.frame,
        "created": record.content["created"],
        "expires": record.content["expires"],
        "environment": dict(record.content["environment"]),
        "raw": dict(record.content["raw"]),
        "parent": record.content.get("parent"),
        "signature": None if record.signature is None else record.signature.to_dict(),
        "software": dict(record.content["software"]),
        "poses": len(fit.ids),
        "poses_used": int(np.count_nonzero(used)),
        "rms_residual_g": float(np.sqrt(np.mean(fit.residual_g[:, used] ** 2))) if used.any() else None,
        "worst_pose": {"pose": fit.ids[worst], "sigmas": float(abs(fit.studentised[worst]))} if fit.ids else None,
        "reading_noise_g": result.reading_noise_g,
        "tilt_deg": [float(np.rad2deg(value)) for value in tilt],
        "A": result.A.tolist(),
        "b_g": result.b.tolist(),
        "zones": [
            {
                "name": zone.name,
                "center_deg": None if zone.inc_center_rad is None else float(np.rad2deg(zone.inc_center_rad)),
                "from_deg": float(np.rad2deg(zone.inc_min_rad)),
                "to_deg": float(np.rad2deg(zone.inc_max_rad)),
                "condition": zone.condition,
            }
            for zone in result.zones
        ],
        "fallback": None if record.fallback is None else record.fallback.method,
        "closures": [
            {
                "inc_deg": float(np.rad2deg(closure.inc_rad)),
                "size_g": float(np.linalg.norm(closure.value)),
                "chi2": closure.chi2,
                "p": closure.p,
                "worst_pose": closure.worst_pose,
            }
            for closure in result.closures
        ],
        "laws": [
            {"slug": law.slug, "place": law.place, "channels": list(law.channels), "depends_on": list(law.depends_on)}
            for law in record.laws
        ],
        "uncertainty": uncertainty(record),
        "remarks": [
            {"reason": remark.reason.value, "text": remark.text, "poses": list(remark.poses), "refused": remark.refused}
            for remark in result.remarks
        ],
    }


def uncertainty(record: CalibrationRecord) -> list[dict[str, float | str]]:
    """Standard deviations of I and T over inclination (root mean square over toolface), calibration alone."""
    result = record.result
    tf = np.deg2rad(np.arange(0.0, 360.0, 45.0))
    rows: list[dict[str, float | str]] = []
    for inc_deg in SUMMARY_INCLINATIONS_DEG:
        inc = np.full_like(tf, np.deg2rad(inc_deg))
        source = result
        zone = result.zone_at(float(inc[0]))
        if zone is None and record.fallback is not None:
            source, zone = record.fallback, record.fallback.main
        if zone is None:
            continue
        inc_std, tf_std = source.predict_std(inc, tf, 0.0, zone=zone)
        rows.append(
            {
                "inc_deg": inc_deg,
                "inc_std_deg": float(np.rad2deg(np.sqrt(np.mean(inc_std**2)))),
                "tf_std_deg": float(np.rad2deg(np.sqrt(np.mean(tf_std**2)))),
                "zone": zone.name,
            }
        )
    return rows
