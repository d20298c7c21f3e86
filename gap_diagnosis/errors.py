# pyright: strict
"""What a diagnosis refuses."""

from protocol.errors import TestloomError


class DiagnosisError(TestloomError):
    """Recordings that cannot carry a diagnosis: what is wrong, whose fault it is, what to do."""


class NoReference(DiagnosisError):
    """A recording that could be diagnosed if something told how the unit moved."""
