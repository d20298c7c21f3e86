"""The base of every model on the wire and in the journal."""

from pydantic import BaseModel, ConfigDict


class FrozenModel(BaseModel):
    """An immutable, strict model: unknown fields and silently converted types are errors.

    Strict means that JSON is the way in from outside (`model_validate_json`); Python code
    passes the exact types (tuples, enums).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
