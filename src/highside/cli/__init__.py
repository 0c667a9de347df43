"""The `highside` command: thin; one file a group of commands."""
