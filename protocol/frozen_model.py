"""The base of every model on the wire and in the journal."""

from pydantic import BaseModel, ConfigDict, ValidationError


class FrozenModel(BaseModel):
    """An immutable, strict model: unknown fields and silently converted types are errors.

    Strict means that JSON is the way in from outside (`model_validate_json`); Python code
    passes the exact types (tuples, enums).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def first_problem(error: ValidationError) -> str:
    """What is wrong first, and where in the model, for a sentence that goes on with it."""
    first = error.errors()[0]
    # names of a union's members are steps of validation, not places in the document
    place = ".".join(str(part) for part in first["loc"] if not (isinstance(part, str) and part[:1].isupper()))
    return f"at {place or 'the top'}: {first['msg'].removeprefix('Value error, ')}"
