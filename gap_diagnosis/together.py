# pyright: strict
"""Recordings that are diagnosed together: all of one unit, with one belief."""

from collections.abc import Sequence

from gap_diagnosis.errors import DiagnosisError
from protocol.errors import Fault
from protocol.recordings import Recording


def check_together(recordings: Sequence[Recording]) -> None:
    """One unit, other profiles, runs and mounts: that is what a diagnosis takes together.

    Raises:
        DiagnosisError: none, two units or products, one recording twice, or two beliefs.
    """
    if not recordings:
        raise DiagnosisError(
            "There is no recording to diagnose.",
            where="gap diagnosis",
            fault=Fault.OPERATOR,
            remedy="name at least one recording.",
        )
    for key, what, remedy in (
        ("serial", "units", "diagnose each unit on its own, then compare the reports."),
        ("product", "products", "diagnose each product's recordings on their own."),
    ):
        named = {str(one.unit.get(key, "")): one.recording_id for one in recordings}
        if len(named) > 1:
            listed = ", ".join(f"{name or 'unnamed'} ({recording})" for name, recording in named.items())
            raise _refused(f"The recordings are of several {what}: {listed}.", recordings, remedy)
    seen: dict[str, Recording] = {}
    for one in recordings:
        other = seen.setdefault(one.recording_id, one)
        if other is not one:
            raise _refused(
                f"Two recordings are named '{one.recording_id}'.",
                recordings,
                "leave one out if it was given twice; else give them ids of their own.",
            )
    believed = recordings[0].believed
    other = next((one for one in recordings if one.believed != believed), None)
    if other is not None:
        raise _refused(
            f"The simulator believed one thing of the unit in '{recordings[0].recording_id}' and another in "
            f"'{other.recording_id}'.",
            recordings,
            "write the present belief into all of them.",
        )


def _refused(what: str, recordings: Sequence[Recording], remedy: str) -> DiagnosisError:
    listed = ", ".join(one.recording_id for one in recordings[:10])
    return DiagnosisError(what, where=f"recordings {listed}", fault=Fault.OPERATOR, remedy=remedy)
