"""highside: live acquisition and calibration for directional sensors.

The layers and which may use which stand in `pyproject.toml` (`[tool.importlinter]`), drawn in `docs/architecture.md`.
"""

__version__ = "0.1.0"
