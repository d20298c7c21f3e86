# pyright: strict
"""Seeds of random processes that a run, a unit or a stand has beside each other."""

import numpy as np


def child_seed(seed: np.random.SeedSequence, *purpose: int) -> np.random.SeedSequence:
    """The seed of one of several processes; different purposes are independent, the same is the same.

    Unlike `SeedSequence.spawn` it does not depend on what was drawn before.
    """
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *purpose))
