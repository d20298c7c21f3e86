# pyright: strict
"""A lumped thermal network, solved exactly for ambient temperatures that are straight between samples.

    C dT/dt = P − L (T − T_ambient)        C: heat capacities, L: conductance matrix (ambient taken out)

With C^−½ L C^−½ = V Λ Vᵀ every mode z = Vᵀ C^½ T is a first-order lag of time constant 1/λ behind its own
settled value (Vᵀ C^−½ (P + g T_ambient)) / λ; steps of any length are exact and no grid is involved.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dut_emulator.effects.effect import FloatArray
from dut_emulator.effects.first_order import first_order
from dut_emulator.effects.recursions import lag_coefficients

AMBIENT = "ambient"


@dataclass(frozen=True)
class ThermalNetwork:
    """Nodes with heat capacities, and what heat flows through between them.

    Attributes:
        capacity_j_k: node → J/K; its order is that of all arrays.
        conductance_w_k: (node, node or `AMBIENT`) → W/K.
    """

    capacity_j_k: Mapping[str, float]
    conductance_w_k: Mapping[tuple[str, str], float]

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names, m."""
        return tuple(self.capacity_j_k)

    @cached_property
    def to_ambient_w_k(self) -> FloatArray:
        """(m,)."""
        return np.array([self.conductance_w_k.get((node, AMBIENT), 0.0) for node in self.nodes])

    @cached_property
    def laplacian_w_k(self) -> FloatArray:
        """L, (m, m)."""
        matrix = np.diag(self.to_ambient_w_k)
        for (one, other), conductance in self.conductance_w_k.items():
            if other != AMBIENT:
                i, j = self.nodes.index(one), self.nodes.index(other)
                matrix[[i, j], [i, j]] += conductance
                matrix[[i, j], [j, i]] -= conductance
        return matrix

    @cached_property
    def modes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(m,) rates λ in 1/s; (m, m) from temperatures to modes; (m, m) back."""
        root = np.sqrt(np.array(list(self.capacity_j_k.values())))
        rates, vectors = np.linalg.eigh(self.laplacian_w_k / np.outer(root, root))
        return rates, vectors.T * root, vectors / root[:, np.newaxis]


class ThermalState:
    """The temperatures of a network from one moment on; all at ambient to begin with."""

    def __init__(self, network: ThermalNetwork, ambient_c: float) -> None:
        self._network = network
        self._ambient_c = ambient_c
        self._modes = network.modes[1] @ np.full(len(network.nodes), ambient_c)

    @property
    def temperatures_c(self) -> FloatArray:
        """(m,) now."""
        return self._network.modes[2] @ self._modes

    def advance(self, ambient_c: FloatArray, step_s: float, power_w: FloatArray) -> FloatArray:
        """n equal steps: ambient (n,) at their ends → temperatures (n, m) there. Power (m,) is held.

        However the steps are cut into calls, the result is the same.
        """
        count = len(ambient_c)
        if step_s <= 0 or count == 0:
            return np.repeat(self.temperatures_c[np.newaxis, :], count, axis=0)
        rates, _, back = self._network.modes
        # forcing of a mode: Vᵀ C^−½ x = backᵀ x
        heating, tracking = back.T @ power_w / rates, back.T @ self._network.to_ambient_w_k / rates
        before = np.concatenate([[self._ambient_c], ambient_c[:-1]])
        modes = np.empty((count, len(rates)))
        for mode, rate in enumerate(rates):
            alpha, b0, b1 = lag_coefficients(step_s, 1.0 / float(rate))
            drive = (1.0 - alpha) * heating[mode] + tracking[mode] * (b0 * ambient_c + b1 * before)
            modes[:, mode] = first_order(drive[:, np.newaxis], alpha, alpha * self._modes[mode : mode + 1])[
                :, 0
            ]
        self._ambient_c, self._modes = float(ambient_c[-1]), modes[-1].copy()
        temperatures = np.zeros((count, len(rates)))
        for mode in range(len(rates)):  # by columns, so that chunks of any length round alike
            temperatures += modes[:, mode : mode + 1] * back[:, mode]
        return temperatures
