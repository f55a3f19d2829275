"""What the schemas of all our files share."""

from pydantic import BaseModel, ConfigDict


class Stored(BaseModel):
    """What files of ours hold: nothing unknown, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
