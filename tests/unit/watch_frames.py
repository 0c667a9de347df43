"""Rows of a tool in a hole, made apart from the product's simulator: rests and turns while the inclination builds."""

from __future__ import annotations

import numpy as np

from highside.arrays import Array

G0 = 9.80665


def rows_of_a_well(
    seed: int,
    *,
    stands: int,
    inclinations_deg: tuple[float, float],
    step_g: tuple[float, float, float] = (0.0, 0.0, 0.0),
    step_at: int = 0,
    rate_hz: float = 20.0,
    noise_g: float = 3e-4,
    arm_m: tuple[float, float] = (0.004, -0.003),
    turns_s: float = 90.0,
) -> dict[str, Array]:
    """Columns of a recording: each stand a rest of a minute and a turn with stick-slip, half an hour apart.

    `step_g`: what the offsets become from stand `step_at` on. The gyro has a scale error and a bias.
    """
    rng = np.random.default_rng(seed)
    offset = 5e-5 * rng.standard_normal(3)
    S = 5e-5 * rng.standard_normal((3, 3))
    parts: list[tuple[Array, Array, Array]] = []
    for k in range(stands):
        inclination = np.radians(np.interp(k, [0, stands - 1], inclinations_deg))
        begun = 1800.0 * k
        toolface = rng.uniform(0.0, 2.0 * np.pi)
        for at_rest, lasts, start in ((True, 60.0, 0.0), (False, turns_s, 120.0)):
            t = np.arange(0.0, lasts, 1.0 / rate_hz)
            mean_rate = 0.0 if at_rest else rng.uniform(40.0, 80.0) * 2.0 * np.pi / 60.0
            swing = rng.uniform(0.15, 0.3)
            rate = -mean_rate * (1.0 + 0.4 * np.sin(2.0 * np.pi * swing * t))
            alpha = -mean_rate * 0.4 * 2.0 * np.pi * swing * np.cos(2.0 * np.pi * swing * t)
            turned = mean_rate * (t + 0.4 * (1.0 - np.cos(2.0 * np.pi * swing * t)) / (2.0 * np.pi * swing))
            T = toolface + turned
            s, c = np.sin(inclination), np.cos(inclination)
            f = np.stack([s * np.cos(T), s * np.sin(T), np.full_like(T, c)])
            f[0] += (-(rate**2) * arm_m[0] - alpha * arm_m[1]) / G0
            f[1] += (-(rate**2) * arm_m[1] + alpha * arm_m[0]) / G0
            b = offset + np.array(step_g) * (k >= step_at)
            a = (np.eye(3) + S) @ f + b[:, None] + noise_g * rng.standard_normal(f.shape)
            gyro = np.zeros_like(a)
            gyro[2] = np.degrees(rate) * 1.002 + 0.02
            parts.append((begun + start + t, a, gyro + 0.01 * rng.standard_normal(a.shape)))
    t_s, a, gyro = (np.concatenate([part[i] for part in parts], axis=-1) for i in range(3))
    names = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")
    return {"t_s": t_s, "temp_c": np.full(t_s.size, 25.0), **dict(zip(names, [*a, *gyro], strict=True))}


def poses_of_a_good_tool(seed: int) -> dict[str, Array]:
    """A pose table of the same tool on a bench, its calibration near unity: 8 inclinations, 6 toolfaces."""
    rng = np.random.default_rng(seed)
    inc, tf = (grid.ravel() for grid in np.meshgrid(np.linspace(5.0, 90.0, 8), np.arange(6) * 60.0))
    i, t = np.radians(inc), np.radians(tf)
    g = np.stack([np.sin(i) * np.cos(t), np.sin(i) * np.sin(t), np.cos(i)])
    a = g + 2e-5 * rng.standard_normal(g.shape)
    return {"inc_ref_deg": inc, "tf_ref_deg": tf, "ax": a[0], "ay": a[1], "az": a[2]} | {
        "n": np.full(inc.size, 100.0),
        **{f"std_a{axis}": np.full(inc.size, 1e-4) for axis in "xyz"},
        "temp_c": np.full(inc.size, 25.0),
    }
