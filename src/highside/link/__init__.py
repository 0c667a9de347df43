"""asyncio transports: serial, SocketCAN, python-can, replay, simulated device; one reconnect owner (`supervisor`)."""
