"""`rotation apply` on attitudes, as the live service does: inc_deg, tf_deg of `calibrate apply`, azi_deg of `drift`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.recording.table import Recording
    from highside.rotation import Compensation
    from highside.rotation.recorded import Why

    Floats = NDArray[np.float64]


class Applied(NamedTuple):
    """Columns to add, and what to say: by quantity the rows compensated and why others were not."""

    columns: dict[str, Floats]
    said: dict[str, dict[str, Any]]


def compensated_attitude(table: Recording, compensation: Compensation) -> Applied:
    """Columns inc_comp_deg, tf_comp_deg, azi_comp_deg, and *_comp_std_deg where the recording has *_std_deg."""
    import numpy as np

    from highside.rotation.recorded import attitudes, azimuths

    done = Applied({}, {})
    if not table.has("inc_deg"):
        return done
    theta = np.radians(table.columns["rotor_deg"])
    rate = np.radians(table.columns["rotor_rate_dps"]) if table.has("rotor_rate_dps") else None
    inc = np.radians(table.columns["inc_deg"])

    def add(name: str, values: Floats, std: Floats, why: Why) -> None:
        done.columns[f"{name}_comp_deg"] = np.degrees(values)
        if table.has(f"{name}_std_deg"):
            done.columns[f"{name}_comp_std_deg"] = np.hypot(table.columns[f"{name}_std_deg"], np.degrees(std))
        done.said[name] = {
            "compensated": int(np.isfinite(values).sum()),
            "rotor_unknown": int(why.unknown.sum()),
            "rotation_outside": int(why.outside.sum()),
            "rotation_gap": int(why.gap.sum()),
        }

    if table.has("tf_deg"):
        both = attitudes(compensation, theta, rate, inc, np.radians(table.columns["tf_deg"]))
        if both is not None:
            add("inc", both.inc_rad, both.inc_std_rad, both.why)
            add("tf", both.tf_rad, both.tf_std_rad, both.why)
    if table.has("azi_deg"):
        one = azimuths(compensation, theta, rate, inc, np.radians(table.columns["azi_deg"]))
        if one is not None:
            add("azi", one.azi_rad, one.azi_std_rad, one.why)
    return done
