"""The bench page: one session in a browser, for a technician two metres away. Needs the extra `web`."""
