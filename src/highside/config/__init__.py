"""Configuration models (pydantic) and their reading: file, `--set`, environment, secrets."""
