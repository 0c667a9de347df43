"""What the service's own files have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """Values of a file that the service wrote: an unknown field or a number that is not finite is damage."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
