"""What the models of MQTT payloads have in common, commands and their answers among them."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

LONGEST_ID = 64
"""Characters of a command's id."""


class Payload(BaseModel):
    """JSON of a topic: nothing else than is named, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CommandMessage(Payload):
    """What every command to the service has."""

    id: str = Field(
        min_length=1,
        max_length=LONGEST_ID,
        description="Any, another for each command; the reply carries it. The same command again is not done twice.",
    )
    command: str


class CommandReply(Payload):
    """What every answer to a command has."""

    id: str = Field(description="That of the command; empty where it could not be read.")
    t: float
    ok: bool
    error: str | None = Field(description="Why not, and what to do.")
