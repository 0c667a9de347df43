"""The running daemon: pipeline, outbox and MQTT publisher, recorder, health, sd_notify, reload.

`app.Service` puts it together from `parts`; `pipeline` is the way of a reading and knows no event loop. See
docs/architecture.md for what runs at the same time.
"""

from __future__ import annotations

__all__ = ["app", "messages", "monitor", "outbox", "parts", "pipeline", "publisher", "recorder", "reload", "rig"]
"""the ways in: modules, loaded on request"""
