"""The formats that stand on disk: `table` (CSV Recording and pose tables), `wire` (candump text, serial segments)."""
