"""The running daemon: pipeline, outbox and MQTT publisher, recorder, health, sd_notify, reload."""
