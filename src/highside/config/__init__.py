"""Configuration models (pydantic) and their reading: file, `--set`, environment, secrets.

`settings` is the service, `bench` a bench session, `model` what a simulation knows, `certificate` what a certificate
says beside the record; the others are tables of these. Every mistake is one line with file, table and field.
"""

from __future__ import annotations

__all__ = ["bench", "certificate", "codecs", "drift", "links", "model", "mqtt", "recorder", "rig", "settings", "web"]
"""the ways in: modules, loaded on request"""
