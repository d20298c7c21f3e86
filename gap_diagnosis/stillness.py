# pyright: strict
"""A unit at rest was acted on by constants: what the stand's report scatters then is its own noise.

Left in, that noise would stand in the residual and in the regressors alike, and every effect of motion would
seem to be there (errors in the regressors).
"""

import dataclasses

import numpy as np

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.observation import Observation
from gap_diagnosis.rest import at_rest


def stilled(observation: Observation) -> Observation:
    """The observation with constants for what acted, if the unit was at rest throughout; else as it is."""
    if not at_rest(observation.outputs):
        return observation
    stimulus = observation.stimulus
    constant = {
        name: _constant(values)
        for name in ("rate_rad_s", "specific_force_m_s2", "field_t", "angles_rad", "earth_rate_rad_s")
        if (values := getattr(stimulus, name)) is not None
    }
    outputs = {
        sensor: output
        if sensor == "temperature"
        else dataclasses.replace(output, predicted_si=_constant(output.predicted_si))
        for sensor, output in observation.outputs.items()
    }
    return dataclasses.replace(
        observation, stimulus=dataclasses.replace(stimulus, **constant), outputs=outputs
    )


def _constant(values: FloatArray) -> FloatArray:
    """(n, k) each column's mean where it has a value; NaN stays."""
    there = np.isfinite(values)
    count = np.maximum(there.sum(axis=0), 1)
    return np.where(there, np.where(there, values, 0.0).sum(axis=0) / count, np.nan)
