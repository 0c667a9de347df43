"""asyncio transports: serial, SocketCAN, python-can, replay, simulated device.

A `base.Transport` is one attempt; `base.LinkSupervisor` is the one owner of re-connection.
"""

from __future__ import annotations

__all__ = [
    "base",
    "detect",
    "device",
    "handover",
    "opened",
    "pythoncan",
    "replay",
    "serial",
    "socketcan",
    "tcp_wire",
    "wire",
]
"""the ways in: modules, loaded on request"""
