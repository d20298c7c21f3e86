# pyright: strict
"""Which effects a recording can show at all: those that a plausible size would lift out of the noise.

A delay of a second explains a static record's noise as well as anything else; no link has one. Where the
largest plausible size stays below the noise an effect is not offered: the recording says nothing about it.
"""

import dataclasses

import numpy as np

from gap_diagnosis.design import NUISANCES, Block
from gap_diagnosis.prepared import Prepared

LEAST_SIGNAL = 3.0
LARGEST_PLAUSIBLE = {
    "bandwidth": 0.05,
    "fixed_delay": 0.1,
    "clock_drift": 1e-3,
    "timestamp_jitter": 0.05,
    "wobble": 1e-3,
    "encoder_eccentricity": 1e-3,
    "non_orthogonality": 5e-3,
    "level_drift": 1e-5,
    "rate_ripple": 0.02,
    "lever_arm": 0.2,
    "size_effect": 0.1,
    "earth_rate": 3.0,
    "scale_factor_asymmetry": 0.05,
    "dead_band": 1.0,
    "misalignment_temperature": 1e-3,
    "magnetic_sensitivity": 100.0,
}
"""Word → the largest size of a free parameter, SI: some ten times what is typical (docs/gap.md)."""


def visible_only(prepared: Prepared) -> Prepared:
    """Without the blocks that no plausible size would show."""
    systems = prepared.systems()
    information = {
        channel: np.einsum("pp->p", system.gram[system.believed // 2]) for channel, system in systems.items()
    }

    def shows(block: Block) -> bool:
        largest = LARGEST_PLAUSIBLE.get(block.effects[0].word)
        if largest is None:
            return True
        square = np.zeros(len(block.scalars))
        for channel, columns in block.columns.items():
            held = columns >= 0
            scale = prepared.design.channels[channel].scales[columns[held]]
            square[held] += information[channel][columns[held] - NUISANCES] * (scale * largest) ** 2
        return bool(np.sqrt(np.max(square)) > LEAST_SIGNAL)

    blocks = tuple(block for block in prepared.design.blocks if shows(block))
    return dataclasses.replace(prepared, design=dataclasses.replace(prepared.design, blocks=blocks))
