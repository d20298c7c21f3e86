# pyright: strict
"""What a diagnosis refuses."""

from protocol.errors import TestloomError


class DiagnosisError(TestloomError):
    """Recordings that cannot carry a diagnosis: what is wrong, whose fault it is, what to do."""
