"""Base model of the schemas of all our files."""

from pydantic import BaseModel, ConfigDict


class Stored(BaseModel):
    """Base of the models of our files: no unknown field, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
