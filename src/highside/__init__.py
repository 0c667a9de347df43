"""highside: live acquisition and calibration for directional sensors.

The layers, lowest first, are `errors`, `attitude`, `physics`, `calibration`, `codec`, `recording`, `link`, `config`,
`session`, `service`, `report`, `cli`. Each may use those below it; `pyproject.toml` holds the contracts.
"""

__version__ = "0.1.0"
