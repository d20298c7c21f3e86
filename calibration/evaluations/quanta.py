"""The quantum of each channel of a triad, and what it hides of a mean (`quantized_mean`)."""

# pyright: strict
from collections.abc import Sequence

import numpy as np

from calibration.algorithms.block_means import MAX_OUTLIER_FRACTION
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.quantized_mean import lattice_step, mean_uncertainty
from calibration.evaluations.channels import SI, Kind
from calibration.evaluations.method_evaluation import believed_number, believed_sensor
from protocol.language import say
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

TOLD_FROM = 0.2
"""Part of a figure's uncertainty from which on a sentence says what the quantum does."""


def of_quanta(
    recording: Recording, kind: Kind, outputs: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Quantum of each channel, (m,), 0 where none is seen, and what it hides of the mean of each output.

    Args:
        recording: what states the quantum, if anything.
        kind: of the triad.
        outputs: of one or several runs, each (n, m), SI.

    Returns:
        Quanta (m,) and standard uncertainties (runs, m), SI.
    """
    quanta = np.array([_quantum(recording, kind, samples) for samples in np.concatenate(outputs).T])
    by_quanta = [
        mean_uncertainty(samples, quantum) if quantum > 0.0 else 0.0
        for output in outputs
        for samples, quantum in zip(output.T, quanta.tolist(), strict=True)
    ]
    return quanta, np.reshape(np.array(by_quanta, dtype=np.float64), (len(outputs), len(quanta)))


def quantum_words(
    kind: Kind, letters: str, quanta: FloatArray, by_quanta: FloatArray, u: FloatArray
) -> list[str]:
    """Sentences for the channels where the quantum has a part in `u` that counts, (m,) each."""
    return [
        say(
            "{channel}: its noise hardly blurs its quantum of {quantum}: a mean may be off by {hidden} for "
            "it (standard uncertainty, taken into account); samples at a higher rate have more noise, and "
            "means less of this error",
            channel=f"{kind}_{letter}",
            quantum=f"{quantum:.2g} {SI[kind]}",
            hidden=f"{hidden:.1g} {SI[kind]}",
        )
        for letter, quantum, hidden, told in zip(letters, quanta, by_quanta, u, strict=True)
        if hidden > TOLD_FROM * told
    ]


def _quantum(recording: Recording, kind: Kind, samples: FloatArray) -> float:
    """As stated; as the samples step where nothing is stated, or where they were written more coarsely.

    A single outlier among samples that stay at one number is no step.
    """
    stated, unit = believed_number(recording, kind, "quantum"), believed_sensor(recording, kind).get("unit")
    known = stated * factor_to_si(unit) if stated is not None and isinstance(unit, str) else 0.0
    seen = lattice_step(samples)
    if seen is None:
        return known
    _, counts = np.unique(samples, return_counts=True)
    alone = len(counts) == 2 and float(counts.min()) <= MAX_OUTLIER_FRACTION * len(samples)
    return known if known > 0.0 and alone else max(seen, known)
